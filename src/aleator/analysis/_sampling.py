"""A function of uncertain inputs, ready to be expanded: its outputs at the germ points of an expansion."""

from collections.abc import Callable, Mapping
from typing import Any, final

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from aleator._core.arrays import Pytree, jax_array, numbers_to_arrays
from aleator.ensemble import (
    BoxEnsemble,
    CalledEnsemble,
    Function,
    TracedEnsemble,
    at_levels,
    ensemble_for,
    even_levels,
    uncertain_places,
)
from aleator.expansion import plain
from aleator.uncertainty import AbstractDistribution, AbstractGerm, Interval, placements

# Fresh points of a traced function: so many, and at least this part of the collocation points; of a called one, which
# may take long.
_FRESH, _PART, _CALLED = 8, 10, 2


def fresh_points(
    germs: Mapping[str, AbstractGerm], collocation_points: int, *, traced: bool
) -> Float[np.ndarray, "fresh variables"]:
    """Random germ points at which an expansion is checked, the same at every call: of no lattice, and of no fit."""
    count = max(_FRESH, collocation_points // _PART) if traced else _CALLED
    levels = even_levels(np.random.default_rng([1, count]), count, len(germs))
    return at_levels(germs.values(), levels)


@final
class Sampler:
    """A function of a model's realisations at germ points, with decisions at their initial values.

    If traced, it is differentiable by every number of the model, and other numbers compile nothing anew. If called, it
    is called once per point, however often a point is requested.

    Raises `ProblemError` if nothing in the model is uncertain.
    """

    def __init__(self, function: Function, model: Pytree, *, traced: bool):
        self.places = uncertain_places("expand", function, model, takes_intervals=True)
        self.random = placements(model).distributions
        decisions = {name: place.decision for name, place in self.places.decisions.items()}
        self.intervals = {name: one for name, one in decisions.items() if isinstance(one, Interval)}
        model = numbers_to_arrays(model) if traced else model
        ensemble = ensemble_for(function, model, self.places, traced=traced)
        self._box = ensemble if isinstance(ensemble, BoxEnsemble) else None
        self._outputs: Callable[[Any], Pytree] = ensemble if isinstance(ensemble, TracedEnsemble) else _Once(ensemble)

    @property
    def is_traced(self) -> bool:
        """Whether many points cost little more than one."""
        return not isinstance(self._outputs, _Once)

    @property
    def distributions(self) -> dict[str, AbstractDistribution]:
        """The distribution of each uncertain input by name, with its decisions at their initial values."""
        return {name: distribution.initial() for name, distribution in self.places.distributions.items()}

    def fresh(self, collocation_points: int) -> Float[np.ndarray, "fresh variables"]:
        """The fresh points at which an expansion by so many collocation points is checked."""
        return fresh_points(self.places.germs, collocation_points, traced=self.is_traced)

    def samples(self, points: Float[Array, "points variables"]) -> Pytree:
        """The function at germ points: its outputs with a leading axis for the points.

        Raises the errors of an ensemble.
        """
        return self._outputs(points)

    def present(self, points: Float[Array, "points variables"]) -> tuple[Pytree, Bool[np.ndarray, " points"]]:
        """The function at the germ points that are not left out, which only a box does, and which points these are."""
        if self._box is None:
            return self.samples(points), np.ones(len(points), dtype=bool)
        outputs, present = self._box.kept(points)
        return jax.tree.map(jax_array, outputs), present

    def known(self, points: Float[Any, "points variables"]) -> Pytree:
        """The same as plain numbers, even under differentiation. Raises `ProblemError` inside `jax.jit`."""
        return plain(self.samples(jax_array(points)))


@final
class _Once:
    """A called function that remembers its result at each point, because a call may take long."""

    def __init__(self, ensemble: CalledEnsemble | BoxEnsemble):
        self._ensemble = ensemble
        self._known: dict[bytes, Pytree] = {}

    def __call__(self, points: Float[Array, "points variables"]) -> Pytree:
        known = np.asarray(points)
        keys = [point.tobytes() for point in known]
        new = {key: point for key, point in zip(keys, known, strict=True) if key not in self._known}
        if new:
            outputs = self._ensemble(np.stack(list(new.values())), before=len(self._known))
            self._known |= {key: jax.tree.map(lambda leaf, i=i: leaf[i], outputs) for i, key in enumerate(new)}
        return jax.tree.map(lambda *values: jax_array(np.stack(values)), *(self._known[key] for key in keys))
