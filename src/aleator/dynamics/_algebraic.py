"""`AlgebraicSystem`: outputs in closed form, or by implicit equations between named unknowns, and their solution."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int
from typing_extensions import override

from aleator._core.arrays import is_number, numbers_to_arrays
from aleator._core.errors import ProblemError
from aleator._core.given import traceable
from aleator._core.leaves import named_leaves
from aleator.dynamics._abstract_system import AbstractSystem
from aleator.dynamics._newton import Root, newton
from aleator.dynamics._system import as_outputs, called, starting, state_type

_GOLDEN = (5**0.5 - 1) / 2


class AlgebraicSystem(AbstractSystem):
    """A system without time: closed formulas, statics, equilibria, kinematic assemblies.

    Subclass it with the parameters as fields; any number in a field may then be replaced by a distribution or a
    decision. Where the outputs follow from these in closed form, `def outputs(self)` is all that it takes:

        class Pin(al.AlgebraicSystem):
            hole: al.Number
            pin: al.Number

            def outputs(self):
                return {"gap": self.hole - self.pin}

    Where some numbers are only known by equations (dissertation, equations 17 and 24), name them in `unknowns` and
    declare `guess` and `residual`; `residual(rho)` and `outputs(rho)` then get them as a named tuple (`rho.chi`, or
    unpacked). The equations are solved by Newton's method from `guess`, and derivatives follow from the implicit
    function theorem. Of several solutions it is the one that Newton reaches from the guess. To stay on one branch over
    a wide range of parameters, let the guess depend on them.

    `units` may give the units of outputs, for reports. Raises `ProblemError` for a class that declares only some of
    `unknowns`, `guess` and `residual`, or whose `outputs` takes something else.
    """

    has_time: ClassVar[bool] = False
    unknowns: ClassVar[tuple[str, ...]] = ()

    @property
    @override
    def is_integrated(self) -> bool:
        return False

    def __check_init__(self) -> None:
        _check_declared(self)

    def guess(self) -> Mapping[str, Any]:
        """A number (or an array, for an unknown that is one) near the solution for each unknown, by name."""
        return {}

    def residual(self, rho: Any) -> Any:
        """The equations, as a sequence of numbers or arrays that vanish at the solution: as many as unknowns."""
        del rho
        return ()

    @override
    def outputs(self, *args: Any, **kwargs: Any) -> dict[str, Any]:
        """`outputs(self)`, or `outputs(self, rho)` of a system with unknowns: quantities of interest by name.

        By default the unknowns themselves.
        """
        del kwargs
        (rho,) = args
        return rho._asdict()


class Solved(NamedTuple):
    """The solution of an algebraic system.

    - `unknowns`: as a named tuple; not a number where Newton failed, or found a solution that is not one by itself;
    - `residual_norm`: the largest residual, each relative to how much it changes as the unknowns change by their own
      scale;
    - `iterations`: how many Newton steps were taken.
    """

    unknowns: Any
    converged: Bool[Array, ""]
    residual_norm: Float[Array, ""]
    iterations: Int[Array, ""]


def solve_algebraic(system: AlgebraicSystem) -> Solved:
    """Solve one realised system (plain numbers in its fields). May be vectorised and differentiated repeatedly.

    Raises `ProblemError` if guess and equations do not fit the unknowns. Where Newton fails, the unknowns are not a
    number: see `explain_failure`.
    """
    guess = first_guess(system)
    if not system.unknowns:
        return Solved(guess, jnp.asarray(True), jnp.zeros(()), jnp.zeros((), int))
    root, named = _root(system, guess)
    return Solved(
        named(jnp.where(root.converged, root.point, jnp.nan)),
        root.converged,
        jnp.abs(root.relative).max(),
        root.steps.astype(int),
    )


def algebraic_outputs(system: AlgebraicSystem) -> dict[str, Float[Array, "..."]]:
    """The outputs at the solution; not a number where there is none."""
    solved = solve_algebraic(system)
    values = outputs_at(system, solved.unknowns)
    return {name: jnp.where(solved.converged, value, jnp.nan) for name, value in values.items()}


def outputs_at(system: AlgebraicSystem, rho: Any) -> dict[str, Float[Array, "..."]]:
    """`system.outputs` at any unknowns as arrays by name, checked to be a dict."""
    given = (rho,) if _is_implicit(system) else ()
    return as_outputs(system, called(system, system.outputs, *given))


def explain_failure(system: AlgebraicSystem) -> str:
    """Why Newton fails for one realised system: the system's numbers, where it stopped, the residual and a remedy.

    Empty if it does not fail. Runs on the host: call it for the realisation at fault.
    """
    guess = first_guess(system)
    if not system.unknowns:
        return ""
    root, named = _root(system, guess)
    if root.converged:
        return ""
    worst = int(np.argmax(np.nan_to_num(np.abs(root.relative), nan=np.inf)))
    return (
        f"{type(system).__name__}: Newton found no solution at {_listed(_numbers(system)) or 'any numbers'}. From the "
        f"guess {_listed(guess._asdict())} it came in {int(root.steps)} steps to "
        f"{_listed(named(root.point)._asdict())}, where equation {worst + 1} of {root.relative.size} is left with a "
        f"residual of {float(root.residuals[worst]):.3g}{_remark(root)}. Look whether a solution exists there, and "
        "guess closer to it."
    )


def _declares(system: AlgebraicSystem, part: str) -> bool:
    """Whether the class of a system says something of its own of `part`."""
    default = getattr(AlgebraicSystem, part)
    own = getattr(type(system), part)
    return own is not default and (part != "unknowns" or own != ())


def _is_implicit(system: AlgebraicSystem) -> bool:
    """Whether a system has equations to solve, be there unknowns in them or not."""
    return _declares(system, "residual")


def _check_declared(system: AlgebraicSystem) -> None:
    """Refuse a class that is neither explicit, by `outputs` alone, nor implicit, by all that equations take."""
    name = type(system).__name__
    parts = {part: _declares(system, part) for part in ("unknowns", "guess", "residual")}
    parts["unknowns"] |= bool(system.unknowns)
    has, lacks = ([part for part, declared in parts.items() if declared is one] for one in (True, False))
    if has and lacks:
        raise ProblemError(
            f"{name} declares {' and '.join(has)}, but not {' and '.join(lacks)}: equations take all three; outputs in "
            "closed form take none of them, only outputs(self)."
        )
    if not (has or _declares(system, "outputs")):
        raise ProblemError(
            f"{name} declares no outputs: expected outputs(self), or unknowns with guess and residual for equations."
        )
    expected = ("rho",) if has else ()
    signature = inspect.signature(system.outputs)
    try:
        signature.bind(*expected)
    except TypeError:
        received = ", ".join(("self", *map(str, signature.parameters.values())))
        raise ProblemError(
            f"{name}.outputs: expected outputs({', '.join(('self', *expected))}), for a class "
            f"{'with' if has else 'without'} unknowns; received outputs({received})."
        ) from None


def _numbers(system: AlgebraicSystem) -> dict[str, Any]:
    """The numbers in the fields of a realised system, by name."""
    return {name: leaf for name, leaf in named_leaves(system) if is_number(leaf) or isinstance(leaf, int)}


def _remark(root: Root) -> str:
    if not np.isfinite(root.residuals).all():
        return ", which is not a finite number"
    if not root.regular:
        return "; the Jacobian is singular there: the equations do not determine the unknowns, or two solutions meet"
    return ""


def _listed(numbers: Mapping[str, Any]) -> str:
    style: Any = {"float_kind": "{:.6g}".format}
    return ", ".join(f"{name}={np.array2string(np.asarray(value), formatter=style)}" for name, value in numbers.items())


def _root(system: AlgebraicSystem, guess: Any) -> tuple[Root, Callable[[Array], Any]]:
    """The root over all unknowns as one vector, and what makes a named tuple of such a vector."""
    start, named = ravel_pytree(guess)
    terms = constant_terms(system, guess, start.size)
    return newton(lambda vector: equations(system, named(vector), start.size), start, terms), named


def constant_terms(system: AlgebraicSystem, guess: Any, expected: int) -> Float[Array, " n"]:
    """The sizes of what the system's own numbers add to each equation: as they round, so do the unknowns.

    By derivatives along all numbers at once, with weights in which terms of opposite signs do not cancel.
    """
    dynamic, static = eqx.partition(numbers_to_arrays(system), eqx.is_inexact_array)
    numbers, combined = ravel_pytree(dynamic)
    if not numbers.size:
        return jnp.zeros(expected)
    order = np.arange(1, numbers.size + 1)
    weights = np.stack([0.5 + order * _GOLDEN % 1, (-1.0) ** order * (0.5 + order * _GOLDEN**2 % 1)])

    def of(given: Float[Array, " numbers"]) -> Float[Array, " n"]:
        return equations(eqx.combine(combined(given), static), guess, expected)

    _, along = jax.vmap(lambda weight: jax.jvp(of, (numbers,), (numbers * weight,)))(jnp.asarray(weights))
    return jnp.nan_to_num(jnp.abs(along).max(axis=0), nan=0.0, posinf=0.0)


def first_guess(system: AlgebraicSystem) -> Any:
    """The guess as a named tuple of arrays."""
    given = system.guess()
    if not isinstance(given, Mapping) or set(given) != set(system.unknowns):
        raise ProblemError(
            f"{type(system).__name__}.guess returns a dict with a number for each of the unknowns {system.unknowns}; "
            f"received {given!r}."
        )
    return state_type(system.unknowns)(*starting(f"{type(system).__name__}.guess", system.unknowns, given))


def equations(system: AlgebraicSystem, rho: Any, expected: int) -> Float[Array, " n"]:
    """`system.residual` as one vector, checked (at trace time) to have as many entries as there are unknowns."""
    values = called(system, system.residual, rho)
    name = type(system).__name__
    if not isinstance(values, tuple | list):
        raise ProblemError(f"{name}.residual returns the equations as a tuple; received {values!r}.")
    vector = jnp.concatenate([jnp.zeros(0), *(jnp.ravel(traceable(f"{name}.residual", value)) for value in values)])
    if vector.size != expected:
        raise ProblemError(
            f"{name}.residual: expected as many equations as numbers in the unknowns {system.unknowns}, "
            f"which are {expected}; received {vector.size}."
        )
    return vector
