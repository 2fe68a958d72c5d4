"""`expand`: any function of uncertain inputs as polynomials of them; `Sampler`, which evaluates it at germ points."""

import warnings
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import Any, final, overload

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from aleator._core.arrays import Pytree, in_library, jax_array, numbers_to_arrays
from aleator._core.border import real_array, refuse_not_finite
from aleator._core.compilation import Use, evaluate
from aleator._core.errors import ExpansionWarning, ProblemError
from aleator._core.leaves import in_order, is_traced
from aleator.analysis._abstract_expanded import extrapolates
from aleator.analysis._expanded import ElementExpanded, Expanded
from aleator.analysis._over_intervals import OverIntervals, over_intervals
from aleator.ensemble import (
    BoxEnsemble,
    CalledEnsemble,
    Function,
    TracedEnsemble,
    at_levels,
    concrete,
    corners_of,
    ensemble_for,
    even_levels,
    uncertain_places,
)
from aleator.expansion import (
    ILL_CONDITIONED,
    ROUNDING,
    Adaptive,
    Collocation,
    Discretisation,
    Expansion,
    MultiElement,
    Refinement,
    Sparse,
    at_fewer_points,
    collocate,
    fresh_error,
    plain,
    resolved_instants,
)
from aleator.uncertainty import AbstractDistribution, AbstractGerm, Interval, constant, placements, refuse_intervals

# Fresh points of a traced function: so many, and at least this part of the collocation points; of a called one, which
# may take long.
_FRESH, _PART, _FRESH_CALLED = 8, 10, 2
# At so many corners of the box of intervals, if there are more.
_MOST_ENDS = 4
# An output that spreads less at such a corner, as a part of how it varies in all, is certain there.
_LITTLE = 0.01
# Fresh points by which elements of a function are checked that is called, which may take long.
_CALLED = 128


@overload
def expand(
    function: Function, model: Pytree, expansion: Expansion | None = None, *, times: Any = None, traced: bool = True
) -> Expanded: ...


@overload
def expand(
    function: Function, model: Pytree, expansion: MultiElement, *, times: Any = None, traced: bool = True
) -> ElementExpanded: ...


def expand(
    function: Function,
    model: Pytree,
    expansion: Expansion | MultiElement | None = None,
    *,
    times: Any = None,
    traced: bool = True,
) -> Expanded | ElementExpanded | OverIntervals:
    """Expand a function of uncertain inputs: `al.expand(f, {"w": al.Normal(1.0, 0.1)}, al.Expansion(order=10))`.

    - `function`: takes the model with plain numbers in the place of its distributions and returns an array or a dict of
      arrays (any pytree of them); or an `al.foreign.BlackBox`;
    - `model`: a dict of distributions or any other pytree with distributions in it, such as a `System`. Decisions are
      held at their initial values;
    - `expansion`: order, index set, points and fit, default `Expansion()`; or `MultiElement()` for responses with jumps
      and kinks and for long times;
    - `times`: instants of the outputs' leading axis, so that a warning can say from when on the order is too low;
    - `traced`: False calls the function with plain numbers, point by point, if JAX cannot trace it.

    Returns an `Expanded`: statistics, densities, errors; with `MultiElement()` an `ElementExpanded`, and where numbers
    are `Interval`s an `OverIntervals`, which has bounds of statistics. Differentiable by JAX with respect to all
    numbers of the model, as far as the function is continuous: derivatives at fixed points miss jumps that move between
    them. The derivative by the shape parameter of a distribution has a weak singularity at the ends of its support,
    which `al.points.GaussPoints` integrates best.

    Besides its collocation points the function is evaluated at a few random ones, by which the expansion is checked: 8
    or a tenth as many, two with `traced=False` or for a black box.

    Raises `ProblemError` if nothing is uncertain or the function cannot be traced, `SimulationError` if an output is
    not finite. Warns with `ExpansionWarning` if an output is not resolved, or if the condition number of the
    collocation matrix exceeds a million.
    """
    sampler = Sampler(function, model, traced=traced)
    if isinstance(expansion, MultiElement):
        refuse_intervals("expand by MultiElement", sampler.places, "Take an al.Expansion of a higher order.")
        return _in_elements(sampler, expansion)
    if not isinstance(expansion, Expansion | None):
        raise ProblemError(f"expand: expected an Expansion or a MultiElement; received {expansion!r}.")
    expansion = expansion or Expansion()
    basis, collocation = _discretised(sampler, expansion)
    library, fitted = in_library(collocation.points)
    count, fresh = len(fitted), sampler.fresh(len(fitted))
    outputs, present = sampler.present(jax_array(library.concatenate([fitted, fresh])))
    if not present[:count].all():
        collocation = at_fewer_points(basis, collocation, expansion.fit, present[:count])
    kept, (_, outputs) = int(np.sum(present[:count])), in_library(outputs)
    samples = jax.tree.map(lambda values: jax_array(values[:kept]), outputs)
    coefficients = jax.tree.map(collocation.coefficients, samples)
    # Errors are of numbers that are known under `jax.grad` too: NumPy computes them.
    values, terms, known, at_points = constant((outputs, coefficients, collocation, samples))
    error = partial(fresh_error, basis.matrix(fresh[present[count:]]))
    errors = jax.tree.map(lambda values, terms: error(values[kept:], terms), values, terms)
    told = partial(Expanded, sampler.distributions, basis, fresh_error=errors, tolerance=expansion.tolerance)
    _warn_of_doubts(told(terms, known, at_points), known, times)
    expanded = told(coefficients, collocation, samples)
    if not sampler.intervals:
        return expanded
    of_known = over_intervals(told(terms, known, at_points), sampler.random, sampler.intervals)
    _warn_of_ends(of_known, fresh[present[count:]], jax.tree.map(lambda values: values[kept:], values))
    return over_intervals(expanded, sampler.random, sampler.intervals)


def _warn_of_ends(over: OverIntervals, fresh: Float[np.ndarray, "fresh variables"], outputs: Pytree) -> None:
    """Warn of outputs that are not resolved beside what is random where intervals end, there being all fresh points."""
    if is_traced((over.joint.coefficients, outputs)):
        return
    random, ends = np.split(fresh, [len(over.basis.germs)], axis=1)
    for end in np.unique(ends, axis=0):
        here, given = (ends == end).all(axis=1), over.given((end + 1) / 2)
        matrix, worst = given.basis.matrix(random[here]), 0.0
        for values, own, whole in zip(
            *map(jax.tree.leaves, (outputs, given.coefficients, over.joint.coefficients)), strict=True
        ):
            missed = np.sum((values[here] - np.tensordot(matrix, own, axes=1)) ** 2) / len(matrix)
            spread = np.sum(np.square(own)[1:]) + missed, _LITTLE**2 * np.sum(np.square(whole)[1:])
            least = max(ROUNDING**2 * np.sum(np.square(whole)), np.finfo(float).tiny)
            worst = max(worst, float(np.sqrt(missed / max(*spread, least))))
        if not worst <= over.joint.tolerance:
            where = ", ".join(f"{name} = {x:.4g}" for name, x in over.numbers((end + 1) / 2).items())
            warnings.warn(
                f"At {where} the expansion of order {over.joint.basis.order} errs by {worst:.2g} of the spread that "
                "uncertain inputs cause: spreads and probabilities are unreliable there. Raise the order.",
                ExpansionWarning,
                stacklevel=3,
            )
            return


def _in_elements(sampler: "Sampler", settings: MultiElement) -> ElementExpanded:
    fresh = {} if sampler.is_traced else {"fresh_points": _CALLED}
    refinement = Refinement(sampler.places.germs, settings, lambda at: sampler.samples(jax_array(at)), **fresh)
    refinement.run()
    basis, elements = refinement.basis, (element.coefficients for element in refinement.elements)
    coefficients = jax.tree.map(lambda *terms: basis.division.whole(_stacked(*terms)), *elements)
    about = tuple(refinement.splits), refinement.calls, refinement.error
    return ElementExpanded(sampler.distributions, basis, coefficients, *about)


def _stacked(*terms: Array) -> Array:
    library, known = in_library(list(terms))
    return jax_array(library.stack(known))


def _discretised(sampler: "Sampler", expansion: Expansion) -> Discretisation:
    """Basis and collocation: built once for all functions of one germ, unless the outputs choose the terms."""
    germs = tuple(sampler.places.germs.items())
    if isinstance(expansion.index_set, Adaptive) or isinstance(expansion.fit, Sparse):
        return collocate(dict(germs), expansion, sampler.known)
    try:
        return _kept(germs, expansion)
    except TypeError:  # an index set that holds arrays has no hash
        return _kept.__wrapped__(germs, expansion)


@lru_cache(maxsize=64)
def _kept(germs: tuple[tuple[str, AbstractGerm], ...], expansion: Expansion) -> Discretisation:
    # Kept values must not belong to a function that is being traced.
    with jax.ensure_compile_time_eval():
        return collocate(dict(germs), expansion)


def _warn_of_doubts(expanded: Expanded, collocation: Collocation, times: Any) -> None:
    """Warn of an ill-conditioned matrix, and of outputs that are not resolved: from when on, if instants are known."""
    errors = jax.tree_util.tree_leaves_with_path(expanded.error)
    until = [None] * len(errors) if times is None else _resolved_until(expanded, real_array("expand: times", times))
    checks = zip(jax.tree.leaves(expanded.leave_one_out), jax.tree.leaves(expanded.jackknife), strict=True)
    bad, open_ended = [], []
    for (path, error), last, (loo, left) in zip(errors, until, checks, strict=True):
        known = concrete(error)
        if known is None or (known <= expanded.tolerance and last is None):
            continue
        name = jax.tree_util.keystr(path, simple=True, separator=".") or "the output"
        if last is None and extrapolates(concrete(loo), concrete(left), expanded.tolerance):
            open_ended.append(f"{name} (error {float(known):.2g})")
            continue
        since = "" if last is None else f", resolved {last}"
        bad.append(f"{name} (error {float(known):.2g}{since})")
    sentences = []
    condition = concrete(collocation.condition_number)
    if condition is not None and not condition <= ILL_CONDITIONED:
        sentences.append(
            f"The collocation matrix has condition number {float(condition):.1e} (limit "
            f"{ILL_CONDITIONED:.0e}), so coefficients lose digits. Use more points or a lower order, or "
            "al.points.ChristoffelPoints()."
        )
    if bad:
        sentences.append(
            f"The expansion of order {expanded.basis.order} does not resolve {', '.join(bad)}: errors above "
            f"{expanded.tolerance:g} make means and spreads unreliable. Raise the order, shorten a simulation, or "
            "take al.expand with al.MultiElement()."
        )
    if open_ended:
        sentences.append(
            f"The expansion of order {expanded.basis.order} extrapolates {', '.join(open_ended)} into the tails of the "
            "distributions, beyond the outermost points, which predict each other only: means and spreads are "
            "unreliable. Take points that cover the tails, al.points.InducedPoints() or al.points.GaussPoints(); a "
            "higher order makes it worse."
        )
    if sentences:
        warnings.warn(" ".join(sentences), ExpansionWarning, stacklevel=3)


def _resolved_instants(tolerance: float) -> Callable[..., Array]:
    return partial(evaluate, partial(resolved_instants, tolerance=tolerance), use=Use.ONCE)


def _resolved_until(expanded: Expanded, times: np.ndarray) -> list[str | None]:
    """Until when each output is resolved that is not resolved throughout, in words; None for the others."""
    refuse_not_finite("expand: times", times)
    for leaf in jax.tree.leaves(expanded.samples):
        if times.ndim != 1 or leaf.ndim < 2 or leaf.shape[1] != len(times):
            raise ProblemError(
                f"expand: times has {times.size} instants, so each output needs a leading axis of {times.size}; "
                f"received shape {leaf.shape[1:]}."
            )
    counts = [concrete(count) for count in jax.tree.leaves(expanded.checked(_resolved_instants(expanded.tolerance)))]
    known = [len(times) if count is None else int(count) for count in counts]
    until = [f"until t = {times[count - 1]:.4g} only" if count else "at no instant" for count in known]
    return [None if count == len(times) else word for count, word in zip(known, until, strict=True)]


def fresh_points(
    germs: Mapping[str, AbstractGerm], collocation_points: int, *, traced: bool
) -> Float[np.ndarray, "fresh variables"]:
    """Random germ points at which an expansion is checked, the same at every call: of no lattice, and of no fit."""
    count = max(_FRESH, collocation_points // _PART) if traced else _FRESH_CALLED
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
        model = in_order(model)
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
        """The fresh points at which an expansion by so many collocation points is checked; intervals are at their ends,
        where polynomials err most.
        """
        fresh = fresh_points(self.places.germs, collocation_points, traced=self.is_traced)
        if count := len(self.intervals):
            ends = 2 * corners_of(count, _MOST_ENDS, np.random.default_rng(0)) - 1
            at, times = (len(ends), len(fresh)) if self.is_traced else (1, 1)
            fresh = np.tile(fresh, (at, 1))
            fresh[:, -count:] = np.resize(np.repeat(ends, times, axis=0), (len(fresh), count))
        return fresh

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
