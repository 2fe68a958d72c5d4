"""`AlgebraicSystem`: outputs in closed form, or from implicit equations for named unknowns, and their solution."""

import inspect
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float
from typing_extensions import override

from aleator._core.compilation import Use, evaluate
from aleator._core.errors import ProblemError
from aleator.dynamics._evaluation import as_equations, as_outputs, starting
from aleator.dynamics._grid import AbstractGrid, Inputs, Instant
from aleator.dynamics._newton import Named, Root, failure_text, listed, named_root, numbers_in
from aleator.dynamics._system import AbstractSystem, called, state_type


class AlgebraicSystem(AbstractSystem):
    """A system without time: explicit formulas, statics, equilibria, kinematic assemblies.

    Subclass it with the parameters as fields; any number in a field may then be replaced by a distribution or a
    decision. Outputs that follow from these in closed form need only `def outputs(self)`:

        class Pin(al.AlgebraicSystem):
            hole: al.Number
            pin: al.Number

            def outputs(self):
                return {"gap": self.hole - self.pin}

    Where numbers are defined implicitly by equations (dissertation, equations 17 and 24), name them in `unknowns` and
    declare `guess` and `residual`; `residual(rho)` and `outputs(rho)` then receive them as a named tuple (`rho.chi`, or
    unpacked). The equations are solved by Newton's method from `guess`, and derivatives follow from the implicit
    function theorem. Of several solutions, Newton's method finds the one it reaches from the guess. To stay on one
    branch over a wide range of parameters, let the guess depend on them.

    `units` may give the units of outputs, for reports. Raises `ProblemError` for a class that declares only some of
    `unknowns`, `guess` and `residual`, or whose `outputs` takes other arguments.
    """

    has_time: ClassVar[bool] = False
    unknowns: ClassVar[tuple[str, ...]] = ()

    @property
    @override
    def is_integrated(self) -> bool:
        return False

    @property
    def is_implicit(self) -> bool:
        """Whether it has equations to solve, even without unknowns."""
        return _declares(self, "residual")

    def __check_init__(self) -> None:
        self.check_declaration()

    def check_declaration(self) -> None:
        """Refuse a class that is neither explicit (only `outputs`) nor implicit (`unknowns`, `guess`, `residual`)."""
        parts = {part: _declares(self, part) for part in ("unknowns", "guess", "residual")}
        parts["unknowns"] |= bool(self.unknowns)
        has, lacks = ([part for part, is_own in parts.items() if is_own is wanted] for wanted in (True, False))
        if has and lacks:
            raise ProblemError(
                f"{self.title} declares {' and '.join(has)}, but not {' and '.join(lacks)}: implicit equations need "
                "all three, and outputs in closed form need none of them, only outputs(self)."
            )
        if not (has or _declares(self, "outputs")):
            raise ProblemError(
                f"{self.title} declares no outputs: expected outputs(self), or unknowns with guess and residual for "
                "equations."
            )
        _check_arguments(self, ("rho",) if has else ())

    def guess(self) -> Mapping[str, Any]:
        """A value near the solution for each unknown, by name: a number, or an array for an unknown array."""
        return {}

    def residual(self, rho: Any) -> Any:
        """The equations: a sequence of numbers or arrays that vanish at the solution, as many as there are unknowns."""
        del rho
        return ()

    def outputs(self, *args: Any, **kwargs: Any) -> dict[str, Any]:
        """`outputs(self)`, or `outputs(self, rho)` for a system with unknowns: quantities of interest by name.

        The unknowns themselves by default.
        """
        del kwargs
        (rho,) = args
        return rho._asdict()


class Solved(NamedTuple):
    """The solution of an algebraic system.

    - `unknowns`: as a named tuple; NaN where Newton failed, or found a solution that is not isolated.
    """

    unknowns: Any
    converged: Bool[Array, ""]


def solve_algebraic(system: AlgebraicSystem) -> Solved:
    """Solve one realised system (plain numbers in its fields). May be vectorised and differentiated repeatedly.

    Raises `ProblemError` if guess or equations do not match the unknowns. Where Newton fails, the unknowns are NaN: see
    `explain_failure`.
    """
    guess = first_guess(system)
    if not system.unknowns:
        return Solved(guess, jnp.asarray(True))
    root, named = _root(system, guess)
    return Solved(named(jnp.where(root.converged, root.point, jnp.nan)), root.converged)


def outputs_at(system: AlgebraicSystem, rho: Any = None) -> dict[str, Float[Array, "..."]]:
    """`system.outputs` at given unknowns as arrays by name, checked to be a dict."""
    unknowns = (rho,) if system.is_implicit else ()
    return as_outputs(system, called(system, system.outputs, *unknowns))


def history_alone(system: AlgebraicSystem, grid: AbstractGrid, inputs: Inputs) -> dict[str, Float[Array, "1 ..."]]:
    """The outputs at the solution, at the one instant; NaN where there is none.

    Raises `ProblemError` for a grid in time, and for inputs.
    """
    if not isinstance(grid, Instant):
        raise ProblemError(
            f"{system.title} is algebraic, without time: expected al.Instant() as its grid; received "
            f"{type(grid).__name__}."
        )
    if inputs:
        raise ProblemError(f"{system.title} is algebraic and takes no inputs; received {sorted(inputs)}.")
    solved = solve_algebraic(system)
    values = outputs_at(system, solved.unknowns)
    return {name: jnp.where(solved.converged, value, jnp.nan)[None] for name, value in values.items()}


def explain_failure(system: AlgebraicSystem) -> str:
    """Why Newton fails for one realised system: the system's numbers, where it stopped, the residual and a remedy.

    Empty if it does not fail. Not traceable: call it for the one realisation at fault.
    """
    if not system.unknowns:
        return ""
    first_guess(system)  # which refuses numbers that are known not to be finite
    root, reached, guess = jax.tree.map(np.asarray, evaluate(_tried, system, use=Use.ONCE))
    if root.converged:
        return ""
    return (
        f"{system.title}: Newton found no solution at {listed(numbers_in(system)) or 'any numbers'}. "
        f"{failure_text(root, reached, guess)} Check whether a solution exists there, and guess closer to it."
    )


def _tried(system: AlgebraicSystem) -> tuple[Root, Any, Any]:
    """Where Newton's method ends, the unknowns there, and the guess from which it begins."""
    guess = first_guess(system)
    root, named = _root(system, guess)
    return root, named(root.point), guess


def _declares(system: AlgebraicSystem, part: str) -> bool:
    """Whether the class of a system declares its own `part`."""
    default = getattr(AlgebraicSystem, part)
    own = getattr(type(system), part)
    return own is not default and (part != "unknowns" or own != ())


def _check_arguments(system: AlgebraicSystem, expected: tuple[str, ...]) -> None:
    """Refuse an `outputs` that takes other arguments."""
    signature = inspect.signature(system.outputs)
    try:
        signature.bind(*expected)
    except TypeError:
        received = ", ".join(("self", *map(str, signature.parameters.values())))
        raise ProblemError(
            f"{system.title}.outputs: expected outputs({', '.join(('self', *expected))}), for a class "
            f"{'with' if expected else 'without'} unknowns; received outputs({received})."
        ) from None


def _root(system: AlgebraicSystem, guess: Any) -> tuple[Root, Named]:
    size = ravel_pytree(guess)[0].size
    return named_root(lambda system, rho: equations(system, rho, size), system, guess)


def first_guess(system: AlgebraicSystem) -> Any:
    """The guess as a named tuple of arrays."""
    values = system.guess()
    if not isinstance(values, Mapping) or set(values) != set(system.unknowns):
        raise ProblemError(
            f"{system.title}.guess returns a dict with a number for each of the unknowns {system.unknowns}; "
            f"received {values!r}."
        )
    return state_type(system.unknowns)(*starting(f"{system.title}.guess", system.unknowns, values))


def equations(system: AlgebraicSystem, rho: Any, expected: int) -> Float[Array, " n"]:
    """`system.residual` as one vector, checked (at trace time) to have as many entries as there are unknowns."""
    return as_equations(system, called(system, system.residual, rho), system.unknowns, expected)
