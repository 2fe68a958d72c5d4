"""A mechanical system at one instant: methods that may take the time, signals in fields replaced by their values.

A parameter `θ(t)` is a signal in place of a number, like a distribution. At an instant the model is the same tree with
the signals' values. It stores the time and the signals' derivatives, so that any quantity computed from it has a total
time derivative, as in equation (65): `∂/∂t` and `θ̇ ∂/∂θ` together. What a class declares (methods, some of which take
the time, and names) is read from it once.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from functools import cache
from itertools import product
from typing import Any, NamedTuple, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import in_library, jax_array
from aleator._core.border import refuse_slip
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.dynamics import Grid
from aleator.trajectories import AbstractSignal, AbstractTrajectory

Model = TypeVar("Model", bound=eqx.Module)


class Method(NamedTuple):
    """A method that a subclass may write: its arguments, and the shape of its value by what there is one entry for."""

    arguments: tuple[str, ...]
    shape: tuple[str, ...] = ()


_AT, _MOVING, _FORCE = ("q",), ("q", "v"), ("speeds",)
METHODS: Mapping[str, Method] = {
    "mass_matrix": Method(_AT, ("speeds", "speeds")),
    "velocity_map": Method(_AT, ("coordinates", "speeds")),
    "actuation": Method(_AT, ("speeds", "actuators")),
    "potential_energy": Method(_AT),
    "bias": Method(_MOVING, _FORCE),
    "coriolis": Method(_MOVING, ("speeds", "speeds")),
    "forces": Method(_MOVING, _FORCE),
    "constraint": Method(_AT, ("constraint_names",)),
    "constraint_jacobian": Method(_AT, ("constraint_names", "speeds")),
    "velocity_constraint": Method(_MOVING, ("velocity_constraint_names",)),
    "torque_bounds": Method(_MOVING),
    "load": Method(_MOVING, _FORCE),
    "body_loads": Method(_MOVING),
    "kinetic_energy": Method(_MOVING),
    "dissipation": Method(_MOVING),
    "accelerations": Method(("q", "v", "torque"), _FORCE),
    "inverse_dynamics": Method(("q", "v", "v_dot"), _FORCE),
    "forward_dynamics": Method(("q", "v", "force"), _FORCE),
    "bodies": Method(()),
    "closures": Method(()),
}
"""What a subclass may write. Each method may take the time `t`, in s, after its arguments."""

# The terms of some formulations that nobody writes for another purpose.
_TERMS = ("coriolis", "forces", "dissipation", "body_loads")

CONSTRAINTS: Mapping[str, str] = {"constraint_names": "constraint", "velocity_constraint_names": "velocity_constraint"}
"""The names of equations, and the methods that return what is left of these."""

_OPEN = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def call_of(name: str) -> str:
    """A method as it is called without time: `mass_matrix(q)`."""
    return f"{name}({', '.join(METHODS[name].arguments)})"


@cache
def timed_methods(kind: type) -> frozenset[str]:
    """The methods of a class of mechanical systems that take the time.

    Raises `ProblemError` for a method with missing or unknown arguments.
    """
    return frozenset(name for name in METHODS if hasattr(kind, name) and _names_time(kind, name))


def _names_time(kind: type, name: str) -> bool:
    parameters = list(inspect.signature(getattr(kind, name)).parameters.values())[1:]
    count = len(METHODS[name].arguments)
    plain = [one for one in parameters if one.kind not in _OPEN]
    own, further = plain[:count], plain[count:]
    unknown = [one for one in further if one.name != "t" and one.default is inspect.Parameter.empty]
    too_few = len(own) < count and len(plain) == len(parameters)
    if too_few or unknown or any(one.name == "t" for one in own):
        with_time = ", ".join((*METHODS[name].arguments, "t"))
        raise ProblemError(
            f"{kind.__name__}.{name}: expected {call_of(name)}, or {name}({with_time}) where it depends on time; "
            f"received {name}({', '.join(str(one) for one in parameters)}). Put anything else it needs into fields."
        )
    return any(one.name == "t" for one in further)


def refuse_lost(kind: Any) -> None:
    """Raise `ProblemError` for methods that would do nothing, and for constraints of a base class that would go.

    Such are those of another formulation, as `forces` beside energies; and a method that is called much like one that
    the class has, with as many arguments, is a slip.
    """
    who, bases = kind.__name__, kind.__mro__[1:]
    motions = (base for base in bases if "bias" in vars(base) and not getattr(base.bias, "__isabstractmethod__", False))
    formulation = next(motions, None)
    for name, value in vars(kind).items():
        if name.startswith("_") or any(hasattr(base, name) for base in bases) or not inspect.isfunction(value):
            continue
        if name in METHODS:
            # A formulation itself calls what it defines; energies and bodies may be quantities of one's own.
            if name in _TERMS and formulation is not None:
                raise ProblemError(
                    f"{who}.{name} has no effect: {formulation.__name__} has no {call_of(name)}. Write forces on the "
                    "side of torques as load(q, v); rename it if it is a quantity of your own."
                )
            continue
        count = len(inspect.signature(value).parameters) - 1
        alike = [one for one, own in METHODS.items() if hasattr(kind, one) and count - len(own.arguments) in (0, 1)]
        refuse_slip(who, name, alike)
    for base, (field, method) in product(bases, CONSTRAINTS.items()):
        names, declared = vars(base).get(field, ()), getattr(kind, field)
        known = isinstance(names, tuple | list) and isinstance(declared, tuple | list)
        if lost := [name for name in names if name not in declared] if known else []:
            raise ProblemError(
                f"{who}.{field} leaves out {lost} of {base.__name__}. Name them too, and return their equations as "
                f"well: (*super().{call_of(method)}, ...)."
            )


@final
class When(Module):
    """The time data of a model at one instant.

    - `t`: the time, s; `rates`: for each order from one, the time derivatives of all signals;
    - `places`: the positions of the signals' values among the leaves of the model.
    """

    t: Any
    rates: tuple[tuple[Array, ...], ...]
    places: tuple[int, ...] = eqx.field(static=True)


@final
class Columns(AbstractSignal):
    """The numbers of signals side by side."""

    parts: tuple[AbstractSignal, ...]

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, " numbers"]:
        return jnp.concatenate([jnp.ravel(part(t)) for part in self.parts])

    @override
    def over(self, t_start: Any, t_final: Any) -> "Columns":
        return Columns(tuple(part.over(t_start, t_final) for part in self.parts))

    @override
    def sampled(
        self, fractions: Float[np.ndarray | Array, " n"], t_start: Any, t_final: Any
    ) -> Float[Array, "n numbers"]:
        xp, parts = in_library([part.sampled(fractions, t_start, t_final) for part in self.parts])
        return jax_array(xp.concatenate([part.reshape(len(fractions), -1) for part in parts], axis=1))

    @override
    def span(self) -> tuple[float, float]:
        first, last = zip(*(part.span() for part in self.parts), strict=True)
        return max(first), min(last)


@final
class Rate(AbstractSignal):
    """The time derivative of a signal."""

    signal: AbstractSignal

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        return jax.jvp(self.signal, (t,), (jnp.ones_like(t),))[1]

    @override
    def over(self, t_start: Any, t_final: Any) -> "Rate":
        return Rate(self.signal.over(t_start, t_final))

    @override
    def span(self) -> tuple[float, float]:
        return self.signal.span()


def course(model: Any, torque_rates: bool = False) -> dict[str, AbstractSignal]:
    """The signals in a model's fields with as many derivatives as dynamics take, as an input; empty if there are none.

    Constraints and rates of torques take one more each.
    """
    parts = [leaf for leaf in _leaves(model) if isinstance(leaf, AbstractSignal)]
    if not parts:
        return {}
    rows = [tuple(parts)]
    for order in range(1, 2 + torque_rates + bool(model.constraints)):
        rows.append(
            tuple(
                part.derivative(order) if isinstance(part, AbstractTrajectory) else Rate(before)
                for part, before in zip(parts, rows[-1], strict=True)
            )
        )
    return {"parameters": Columns(tuple(part for row in rows for part in row))}


def is_timed(model: eqx.Module) -> bool:
    """Whether a model depends on time, by signals in its fields or by methods that take the time."""
    return bool(timed_methods(type(model))) or any(isinstance(leaf, AbstractSignal) for leaf in _leaves(model))


def at(model: Model, t: Any, parameters: Any) -> Model:
    """A model at an instant, with the values of its `course` there; unchanged if it does not depend on time."""
    leaves, structure = jax.tree.flatten(model, is_leaf=_is_signal)
    places = tuple(i for i, leaf in enumerate(leaves) if isinstance(leaf, AbstractSignal))
    if bool(places) != (parameters is not None):
        raise ProblemError(
            f"{type(model).__name__}: expected {'values of' if places else 'no'} parameters that change with time; "
            f"received {'none' if places else 'an input of that name'}."
        )
    if not is_timed(model):
        return model
    rows = [()] if parameters is None else _split(parameters, [leaves[i] for i in places])
    for place, value in zip(places, rows[0], strict=True):
        leaves[place] = value
    return _remembering(jax.tree.unflatten(structure, leaves), When(t, tuple(rows[1:]), places))


def later(model: Model, s: Any) -> Model:
    """The Taylor expansion of a model a time `s` after its instant, to be differentiated by `s` at zero."""
    when: When | None = model._when  # type: ignore[attr-defined]
    if when is None:
        return model
    leaves, structure = jax.tree.flatten(_remembering(model, None))
    rows = [tuple(leaves[place] for place in when.places), *when.rates]
    moved = [tuple(_taylor(orders, s) for orders in zip(*rows[k:], strict=True)) for k in range(len(rows))]
    for place, value in zip(when.places, moved[0], strict=True):
        leaves[place] = value
    return _remembering(jax.tree.unflatten(structure, leaves), When(when.t + s, tuple(moved[1:]), when.places))


def along_time(function: Callable[..., Any], model: Any, primals: Sequence[Any], tangents: Sequence[Any]) -> Any:
    """`function(model, *at)` and its total time derivative, where the arguments change at the rates `tangents`."""
    zero, one = jnp.zeros(()), jnp.ones(())
    return jax.jvp(lambda s, *where: function(later(model, s), *where), (zero, *primals), (one, *tangents))


def linearised(function: Callable[..., Any], model: Any, primals: Sequence[Any]) -> tuple[Any, Callable[..., Any]]:
    """What `function(model, *at)` returns beside its first value, and the total time derivative of that for `tangents`.

    The function is traced once, also where the tangents follow from what it returns.
    """
    _, change, beside = jax.linearize(
        lambda s, *where: function(later(model, s), *where), jnp.zeros(()), *primals, has_aux=True
    )
    return beside, lambda *tangents: change(jnp.ones(()), *tangents)


class Instants(NamedTuple):
    """A model at the instants of a grid."""

    model: Any
    times: Float[Array, " n"]
    parameters: Float[Array, "n numbers"] | None

    def row(self, i: int) -> tuple[Any, Any]:
        """The time of one instant, and the numbers there of the signals in the model's fields."""
        _, times, parameters = in_library(self.times, self.parameters)
        return times[i], None if parameters is None else parameters[i]

    def each(self, function: Callable[..., Any], *given: Array) -> Any:
        """`function(model, *given)` at every instant, with the rows of `given` there."""
        return jax.vmap(lambda t, row, *own: function(at(self.model, t, row).prepared(), *own))(
            self.times, self.parameters, *given
        )


def instants_of(model: eqx.Module, grid: Grid) -> Instants:
    """A realised model at the instants of a grid."""
    rows = [signal.sampled(grid.fractions, grid.t_start, grid.t_final) for signal in course(model).values()]
    return Instants(model, grid.times, rows[0] if rows else None)


def _is_signal(node: Any) -> bool:
    return isinstance(node, AbstractSignal)


def _leaves(model: eqx.Module) -> list[Any]:
    return jax.tree.leaves(model, is_leaf=_is_signal)


def _split(numbers: Any, signals: Sequence[AbstractSignal]) -> list[tuple[Any, ...]]:
    """The numbers of several signals in the shapes of their values; then those of their derivatives."""
    # Not of a signal itself: JAX would hash it, with the arrays in it.
    shapes = [jax.eval_shape(signal.__call__, jax.ShapeDtypeStruct((), float)).shape for signal in signals]
    xp, numbers = in_library(numbers)
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
    return [
        tuple(part.reshape(shape) for part, shape in zip(xp.split(row, ends[:-1]), shapes, strict=True))
        for row in numbers.reshape(-1, ends[-1])
    ]


def _taylor(orders: Sequence[Array], s: Any) -> Array:
    """The value after a time `s`, by the Taylor polynomial of a value and its derivatives."""
    total = orders[-1]
    for k in range(len(orders) - 1, 0, -1):
        total = orders[k - 1] + s / k * total
    return total


def _remembering(model: Model, when: When | None) -> Model:
    instant = copy(model)
    object.__setattr__(instant, "_when", when)  # a fresh copy, not shared yet
    return instant
