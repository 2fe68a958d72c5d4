"""A function of uncertain inputs at germ points: traced and compiled, or called point by point."""

import abc
from collections.abc import Callable
from typing import Any, TypeAlias, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Pytree, numbers_to_arrays
from aleator._core.errors import ProblemError, SimulationError
from aleator._core.tracing import Traced, trace
from aleator.analysis._inputs import concrete, inputs_at, plain
from aleator.uncertainty import AbstractDistribution, Survey, realise, survey

Function: TypeAlias = Callable[[Any], Pytree]


class AbstractSampler(abc.ABC):
    """A function of a model's realisations: an array, or a pytree of arrays, at each germ point.

    Decisions of the model stand at their initial values.
    """

    def __init__(self, function: Function, model: Pytree):
        self.function, self.model = function, model
        self.places: Survey = survey(model)
        self._decisions = jnp.asarray(self.places.vector("initial"))

    @property
    def laws(self) -> dict[str, AbstractDistribution]:
        """The law of each uncertain input by name, with its decisions at their initial values."""
        return {name: law.initial() for name, law in self.places.distributions.items()}

    def samples(self, points: Float[Array, "points variables"]) -> Pytree:
        """The function at germ points: its outputs with a leading axis for the points.

        Raises `SimulationError` where an output is not finite, naming the inputs' values there (not under `jax.jit`,
        where no value is known).
        """
        values = self._at(points)
        if not jax.tree.leaves(values):
            raise ProblemError(f"{self._name} returns nothing: expected an array or a dict of arrays.")
        self._refuse_nonfinite(points, values)
        return values

    def known(self, points: Float[Any, "points variables"]) -> Pytree:
        """The same as plain numbers, also where they are differentiated. Raises `ProblemError` inside `jax.jit`."""
        return plain(self.samples(jnp.asarray(points)))

    @abc.abstractmethod
    def _at(self, points: Float[Array, "points variables"]) -> Pytree:
        """The function at germ points."""

    def _realised(self, model: Pytree, point: Float[Array, " variables"]) -> Pytree:
        return realise(model, point, self._decisions)

    @property
    def _name(self) -> str:
        return f"'{getattr(self.function, '__name__', type(self.function).__name__)}'"

    def _refuse_nonfinite(self, points: Float[Array, "points variables"], values: Pytree) -> None:
        for path, leaf in jax.tree_util.tree_leaves_with_path(values):
            known = concrete(leaf)
            if known is None or np.isfinite(known).all():
                continue
            bad = np.asarray(~np.isfinite(known.reshape(len(known), -1)).all(axis=1))
            first = int(np.argmax(bad))
            numbers = inputs_at(self.laws, points[first])
            inputs = ", ".join(f"{name}={number:.6g}" for name, number in numbers.items())
            raise SimulationError(
                f"{self._name} is not finite at {bad.sum()} of {len(bad)} points: {_called(path)} first at point "
                f"{first + 1} ({inputs}). Narrow the laws of the inputs, or mend the function there."
            )


@final
class TracedSampler(AbstractSampler):
    """Samples all points at once: the function is traced by JAX, vectorised and compiled once for its equations."""

    def __init__(self, function: Function, model: Pytree):
        super().__init__(function, model)
        self._numbers, self._rest = eqx.partition(numbers_to_arrays(model), eqx.is_array)
        self._traced: dict[int, Traced] = {}

    @override
    def _at(self, points: Float[Array, "points variables"]) -> Pytree:
        if len(points) not in self._traced:
            self._traced[len(points)] = self._trace(points)
        return self._traced[len(points)](self._numbers, points)

    def _trace(self, points: Float[Array, "points variables"]) -> Traced:
        def outputs(numbers: Pytree, points: Float[Array, "points variables"]) -> Pytree:
            model = eqx.combine(numbers, self._rest)
            return jax.vmap(lambda point: self._arrays(self.function(self._realised(model, point))))(points)

        try:
            return trace(outputs, self._numbers, points, code=self.function, name=self._name)
        except (jax.errors.JAXTypeError, jax.errors.NonConcreteBooleanIndexError) as error:
            raise ProblemError(
                f"{self._name} cannot be traced by JAX ({str(error).splitlines()[0]}) Write it with jax.numpy, or "
                "say traced=False: it is then called with plain numbers, point by point, and has no derivatives."
            ) from error

    def _arrays(self, outputs: Pytree) -> Pytree:
        return jax.tree.map(lambda value: real_array(value, self._name, jnp), outputs)


@final
class CalledSampler(AbstractSampler):
    """Samples point by point with plain numbers: for NumPy, external programs, measurements. No derivatives."""

    def __init__(self, function: Function, model: Pytree):
        super().__init__(function, model)
        self._outputs: dict[bytes, Pytree] = {}
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(model)):
            raise ProblemError(
                f"{self._name} is called with plain numbers (traced=False), so nothing can be differentiated or "
                "compiled through it. Write it with jax.numpy and leave traced=False away."
            )

    @override
    def _at(self, points: Float[Array, "points variables"]) -> Pytree:
        outputs = [self._call(point) for point in points]
        shapes = [(jax.tree.structure(one), [leaf.shape for leaf in jax.tree.leaves(one)]) for one in outputs]
        if any(shape != shapes[0] for shape in shapes):
            odd = next(shape for shape in shapes if shape != shapes[0])
            raise ProblemError(
                f"{self._name} must return arrays of the same shapes at every point; received {shapes[0][1]} and "
                f"{odd[1]}."
            )
        return jax.tree.map(lambda *values: jnp.asarray(np.stack(values)), *outputs)

    def _call(self, point: Float[Array, " variables"]) -> Pytree:
        """The outputs at one point; each point is called once, for a call may take long."""
        key = np.asarray(point).tobytes()
        if key not in self._outputs:
            outputs = self.function(jax.tree.map(_as_python, self._realised(self.model, point)))
            self._outputs[key] = jax.tree.map(lambda value: real_array(value, self._name, np), outputs)
        return self._outputs[key]


def real_array(value: Any, name: str, library: Any) -> Any:
    """One output as a 64-bit array of `library` (NumPy or its like in JAX)."""
    kind = getattr(value, "dtype", None)
    real = isinstance(value, bool | int | float) if kind is None else np.dtype(kind).kind in "biuf"
    if not real:
        raise ProblemError(
            f"{name} must return a real array or a dict of real arrays; received {type(value).__name__}"
            f"{'' if kind is None else f' of {kind}'}. Return jnp.stack(...) of a list, real parts of a complex array."
        )
    return library.asarray(value, dtype=float)


def _as_python(leaf: Any) -> Any:
    """A realised number as plain Python and NumPy know it."""
    if not isinstance(leaf, jax.Array):
        return leaf
    return leaf.item() if leaf.ndim == 0 else np.asarray(leaf)


def _called(path: Any) -> str:
    name = jax.tree_util.keystr(path, simple=True, separator=".")
    return f"output '{name}'" if name else "its output"
