"""A function at many realisations of a model: traced and compiled by JAX, called with plain numbers, or a black box.

Simulating the systems of a problem (evidence, scenarios of the worst case, outputs that choose an expansion's terms) is
not done here: those programs take the problem's numbers as arguments, at any decisions, and reduce the results within
the same program. They share levels, batches and messages with this package, and stand where they are used.
"""

import abc
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, ClassVar, NamedTuple, TypeAlias, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float
from typing_extensions import override

from aleator._core.arrays import NUMBER, Pytree, jax_array, refuse_beyond_memory
from aleator._core.compilation import evaluate_traced
from aleator._core.equations import TIME, TracedFunction, digest_of, refuse_unsteady, switches
from aleator._core.errors import ProblemError
from aleator._core.leaves import is_traced, named_leaves
from aleator.ensemble._batches import Part, at_levels, each, fill, joined
from aleator.ensemble._outputs import (
    UNTRACEABLE,
    Function,
    inputs_at,
    listed,
    name_of,
    outputs_of,
    refuse_nonfinite,
)
from aleator.uncertainty import Placements, placements, realised_over, refuse_intervals, refuse_nonpositive, with_germs


class Realisation(NamedTuple):
    """A model with plain numbers: the number of its sample, from 1 on, and the values of its uncertain inputs."""

    number: int
    model: Pytree
    inputs: dict[str, float]

    def __str__(self) -> str:
        return f"sample {self.number} ({listed(self.inputs)})"


class AbstractBox(abc.ABC):
    """A function of a realised model that is never traced, and is asked for many realisations at once."""

    @abc.abstractmethod
    def __call__(self, realised: Pytree) -> Pytree:
        """The outputs at one realisation."""

    @abc.abstractmethod
    def at_all(self, realisations: Sequence[Realisation], *, whole: bool) -> list[Pytree | None]:
        """The outputs at each realisation as finite NumPy arrays of the same shapes; None where a sample is left out.

        `whole`: no sample may be left out, because the method needs all of them.
        """

    @property
    def follows_from(self) -> Any:
        """All that its outputs follow from besides the model, for a journal; None if its results are not kept there."""
        return None


Points: TypeAlias = Float[np.ndarray, "points variables"] | Float[Array, "points variables"]


def uncertain_places(verb: str, function: Function, model: Pytree, *, takes_intervals: bool = False) -> Placements:
    """The placements of a model, with germ variables of intervals if a method takes any.

    Raises `ProblemError` if nothing is uncertain, if a number declared positive can reach zero, or if `function` is not
    callable.
    """
    if not callable(function):
        raise ProblemError(f"{verb}: expected a function of the model; received {type(function).__name__}.")
    refuse_nonpositive(model)
    places = placements(model)
    if takes_intervals:
        places = with_germs(places)
    else:
        refuse_intervals(verb, places)
    if not places.distributions:
        raise ProblemError(
            f"{verb}: nothing in the model is uncertain; put a distribution, such as al.Uniform.bounds(0.9, 1.1), in "
            "the place of a number."
        )
    return places


# More known points than this are evaluated in parts of so many, so that one compiled size serves all.
_TOGETHER = 1024


class Alone(NamedTuple):
    """What an ensemble is made of, to be sent to another process: `again` makes it anew."""

    kind: "type[AbstractEnsemble]"
    function: Function
    model: Pytree

    def again(self) -> "AbstractEnsemble":
        """The same ensemble in this process."""
        return self.kind(self.function, self.model, placements(self.model))


class AbstractEnsemble(abc.ABC):
    """A function at the realisations of a model, with decisions at their initial values.

    `places`: what is uncertain in the model, from `uncertain_places`.
    """

    at_once: ClassVar[bool]
    """Whether several threads may evaluate it at once."""

    def __init__(self, function: Function, model: Pytree, places: Placements):
        self._function, self._model, self.places = function, model, places
        self._name, self._decisions = name_of(function), jax_array(places.vector("initial"))

    def __call__(self, points: Points, before: int = 0) -> Pytree:
        """The outputs at germ points, each with a leading axis for the points; `before`: how many points came earlier.

        Raises `SimulationError` where an output is not finite, naming the inputs' values there (not under `jax.jit`,
        where values are unknown), and `ProblemError` if an output is no real array or changes its shape.
        """
        return self._checked(self._of_size(len(points))(points, before), points, before)

    def in_parts(self, some: Sequence[Part], size: int) -> Iterator[tuple[Part, Pytree]]:
        """The outputs at parts of probability levels, none of more than `size`, in order, each with its part.

        Raises the same errors as a call.
        """
        evaluate, germs = self._of_size(size), self.places.germs.values()

        def outputs(part: Part) -> Pytree:
            points = at_levels(germs, part.points)
            return self._checked(evaluate(points, part.first), points, part.first)

        return each(outputs, some, at_once=self.at_once)

    def alone(self) -> Alone:
        """What it is made of, without anything compiled."""
        return Alone(type(self), self._function, self._model)

    @abc.abstractmethod
    def _of_size(self, size: int) -> Callable[[Points, int], Pytree]:
        """A function that gives the outputs at `size` points or fewer, already traced if tracing is needed.

        Its second argument is the number of points that came earlier.
        """

    def _at(self, model: Pytree, decisions: Float[Array, " n_x"], point: Any, library: Any) -> Pytree:
        """The outputs at one realisation, as arrays of `library`."""
        realised = self._given(realised_over(model, jax_array(point), decisions))
        return outputs_of(self._function, realised, library, None if self.at_once else lambda: self._place(point))

    def _place(self, point: Any) -> str:
        """A realisation in words: its germ point and the values there."""
        germ = ", ".join(f"{value:.6g}" for value in np.asarray(point))
        return f"germ point ({germ}), where {listed(inputs_at(self.places, point, self._decisions))}"

    def _given(self, realised: Pytree) -> Pytree:
        """A realised model in the form in which the function takes it."""
        return realised

    def _checked(self, outputs: Pytree, points: Points, before: int) -> Pytree:
        if not jax.tree.leaves(outputs):
            raise ProblemError(f"{self._name} returns nothing; expected an array or a dict of arrays.")

        def inputs(index: int) -> str:
            return listed(inputs_at(self.places, np.asarray(points)[index], self._decisions))

        refuse_nonfinite(self._name, outputs, inputs, before)
        return outputs


@final
class TracedEnsemble(AbstractEnsemble):
    """All points of a batch at once: JAX traces and vectorises the function, and compiles it once for its equations.

    Arrays of the model are traced too: other values compile nothing anew, and outputs can be differentiated by them.
    """

    at_once: ClassVar[bool] = True

    def __init__(self, function: Function, model: Pytree, places: Placements):
        super().__init__(function, model, places)
        self._numbers, self._rest = eqx.partition(model, eqx.is_array)
        self._traced: dict[int, TracedFunction] = {}

    @override
    def __call__(self, points: Points, before: int = 0) -> Pytree:
        if len(points) <= _TOGETHER or is_traced((points, self._model)):
            return super().__call__(points, before)
        evaluate = self._of_size(_TOGETHER)
        self._refuse_large(_TOGETHER, len(points))
        outputs = joined(lambda part: evaluate(part.points, part.first), np.asarray(points), _TOGETHER)
        return self._checked(jax.tree.map(jax_array, outputs), points, before)

    @override
    def _of_size(self, size: int) -> Callable[[Points, int], Pytree]:
        if size not in self._traced:
            self._traced[size] = self._trace(size)
            self._refuse_large(size, size)
        traced = self._traced[size]

        def outputs(points: Points, before: int) -> Pytree:
            del before
            if len(points) == size:
                return evaluate_traced(traced, self._numbers, self._decisions, jax_array(points))
            filled = jax_array(fill(np.asarray(points), size))
            values = evaluate_traced(traced, self._numbers, self._decisions, filled)
            return jax.tree.map(lambda leaf: np.asarray(leaf)[: len(points)], values)

        return outputs

    def _trace(self, size: int) -> TracedFunction:
        def outputs(
            numbers: Pytree, decisions: Float[Array, " n_x"], points: Float[Array, "points variables"]
        ) -> Pytree:
            model = eqx.combine(numbers, self._rest)
            return jax.vmap(lambda point: self._at(model, decisions, point, jnp))(points)

        points = np.zeros((size, len(self.places.germs)))
        trace = partial(TracedFunction, outputs, self._numbers, self._decisions, points)
        try:
            traced = trace()
            refuse_unsteady(self._name, digest_of(traced.closed), lambda: digest_of(trace().closed))
        except UNTRACEABLE as error:
            raise ProblemError(
                f"{self._name} cannot be traced by JAX ({str(error).splitlines()[0]}) Write it with jax.numpy, or "
                "pass traced=False: it is then called with plain numbers, point by point, without derivatives."
            ) from error
        if any(TIME in one for one in switches(traced.closed.jaxpr)) and not is_traced(self._model):
            # What it simulates may jump: `simulate` tells, if it is given plain numbers.
            self._at(self._model, self._decisions, points[0], jnp)
        return traced

    def _refuse_large(self, size: int, count: int) -> None:
        """Refuse outputs at `count` points that would not fit into memory, by those traced at `size` points."""
        entries = sum(math.prod(one.shape) for one in self._traced[size].closed.out_avals) * count // size
        what = f"{self._name}: {entries:.3g} numbers at {count} points"
        refuse_beyond_memory(what, 2 * NUMBER * entries, "Return fewer numbers.")


@final
class CalledEnsemble(AbstractEnsemble):
    """Point by point with plain numbers: for NumPy, external programs, measurements. NumPy arrays; no derivatives."""

    at_once: ClassVar[bool] = False

    def __init__(self, function: Function, model: Pytree, places: Placements):
        super().__init__(function, model, places)
        self._first: Pytree = None
        _refuse_traced(model, f"{self._name} is called with plain numbers (traced=False)")

    @override
    def _of_size(self, size: int) -> Callable[[Points, int], Pytree]:
        return lambda points, _: _stacked([values for _, values in each(self._call, [*points], at_once=False)])

    @override
    def _given(self, realised: Pytree) -> Pytree:
        return jax.tree.map(_as_python, realised)

    def _call(self, point: Float[Any, " variables"]) -> Pytree:
        outputs = self._at(self._model, self._decisions, point, np)
        if self._first is None:
            self._first = outputs
        if not same_shapes(outputs, self._first):
            first, now = (jax.tree.map(np.shape, output) for output in (self._first, outputs))
            raise ProblemError(
                f"{self._name} must return arrays of the same shapes at every point; received {first} and {now}."
            )
        return outputs


@final
class BoxEnsemble(AbstractEnsemble):
    """A box, which is given all points of a call at once: it runs them in its own way, and may leave some out."""

    at_once: ClassVar[bool] = False

    def __init__(self, box: AbstractBox, model: Pytree, places: Placements):
        super().__init__(box, model, places)
        self._box = box
        self._names = [name for name, _ in named_leaves(model)]
        _refuse_traced(model, f"{self._name} is a black box")

    @override
    def _of_size(self, size: int) -> Callable[[Points, int], Pytree]:
        return lambda points, before: _stacked(self._box.at_all(self._realisations(points, before), whole=True))

    def kept(self, points: Points) -> tuple[Pytree, Bool[np.ndarray, " points"]]:
        """The outputs at the points that the box does not leave out, and which points these are."""
        outputs = self._box.at_all(self._realisations(points, 0), whole=False)
        present = np.array([output is not None for output in outputs])
        return _stacked([output for output in outputs if output is not None]), present

    def _realisations(self, points: Points, before: int) -> list[Realisation]:
        return [self._realisation(number, point) for number, point in enumerate(np.asarray(points), before + 1)]

    def _realisation(self, number: int, point: Any) -> Realisation:
        model = jax.tree.map(_as_python, realised_over(self._model, jax_array(point), self._decisions))
        numbers = dict(zip(self._names, jax.tree.leaves(model), strict=True))
        named = {name: float(numbers[name]) for name in self.places.distributions if name in numbers}
        return Realisation(number, model, named)


def ensemble_for(
    function: Function, model: Pytree, places: Placements, *, traced: bool
) -> TracedEnsemble | CalledEnsemble | BoxEnsemble:
    """The ensemble in which a function is evaluated: a box in its own way, any other traced or called."""
    if isinstance(function, AbstractBox):
        return BoxEnsemble(function, model, places)
    return (TracedEnsemble if traced else CalledEnsemble)(function, model, places)


def _stacked(outputs: list[Pytree]) -> Pytree:
    return jax.tree.map(lambda *values: np.stack(values), *outputs)


def _refuse_traced(model: Pytree, why: str) -> None:
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(model)):
        raise ProblemError(f"{why}, so nothing can be differentiated or compiled through it. Write it with jax.numpy.")


def same_shapes(first: Pytree, second: Pytree) -> bool:
    """Whether two outputs have the same structure, and arrays of the same shapes."""
    structures = [jax.tree.structure(outputs) for outputs in (first, second)]
    shapes = [[leaf.shape for leaf in jax.tree.leaves(outputs)] for outputs in (first, second)]
    return structures[0] == structures[1] and shapes[0] == shapes[1]


def _as_python(leaf: Any) -> Any:
    """A realised number as a plain Python or NumPy number."""
    if not isinstance(leaf, jax.Array):
        return leaf
    return leaf.item() if leaf.ndim == 0 else np.asarray(leaf)
