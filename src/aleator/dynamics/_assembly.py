"""`Assembly`: a kinematic assembly, described by its vector loops."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.border import members
from aleator._core.errors import ProblemError
from aleator._core.leaves import AbstractLeaf, transparent
from aleator.dynamics._algebraic import AlgebraicSystem
from aleator.dynamics._formula import Formula, check_name, evaluate, names_in, read_equation, read_formula
from aleator.dynamics._vectors import Chain, is_chain, read_chain


class _Description(NamedTuple):
    """An assembly without its dimensions: the static structure, which determines the compiled program."""

    guesses: tuple[tuple[str, float], ...]
    loops: tuple[Chain, ...]
    equations: tuple[tuple[Formula, Formula], ...]
    features: tuple[tuple[str, Formula | Chain], ...]
    units: tuple[tuple[str, str], ...]


@final
@transparent("dimensions")
class Assembly(AlgebraicSystem):
    """Parts that fit together, described by closed vector loops (dissertation, equations 1, 2 and 121).

        Assembly(
            dimensions={"a": Normal(27.645, 0.0167), "c": Normal(11.43, 0.0033), "e": Normal(50.8, 0.0042)},
            unknowns={"b": 4.8, "chi": 7.0},
            loops=[[("a", 90), ("b", 0), ("c", 90), ("c", "90 - chi"), ("-e", "90 - chi")]],
        )

    - `dimensions`: the independent numbers by name; any may be a distribution or a decision;
    - `unknowns`: the dependent numbers by name, each with a guess near its nominal value;
    - `loops`: closed loops (2), each a list of vectors that add up to zero: two equations in the plane, three in space;
    - `equations`: further relations between angles or lengths, such as `"chi + gamma = 180"`;
    - `features`: quantities of interest besides the unknowns, by name (1): a formula, such as `"housing - 3*plate"` for
      a gap, or an open loop, a list of vectors whose tip has the coordinates x, y and, in space, z;
    - `units`: the units of unknowns and features by name, for reports.

    A vector is `(length, direction)`. Lengths, directions, equations and features are formulas: a number, a name, an
    expression of names (`"e - c"`; + - * / **, parentheses, `pi`, `sqrt`, `sin`, `cos`, `tan`, `asin`, `acos`, `atan`)
    or a Python function of all named values (`lambda v: v.e - v.c`). **All angles are in degrees**, measured from the x
    axis: directions, the dimensions and unknowns used in them, their guesses, and arguments and values of the functions
    above. A direction relative to that of the preceding vector uses the word `previous`: `"previous + 90"`. In space a
    direction is a pair of azimuth and elevation.

    The unknowns and the features are its outputs. Raises `ProblemError` if the description is inconsistent.
    """

    dimensions: dict[str, Any]
    description: _Description = eqx.field(static=True)

    def __init__(
        self,
        dimensions: Mapping[str, Any],
        unknowns: Mapping[str, float] | None = None,
        loops: Sequence[Any] = (),
        equations: Sequence[Any] = (),
        features: Mapping[str, Any] | None = None,
        units: Mapping[str, str] | None = None,
    ):
        unknowns, features, units = unknowns or {}, features or {}, units or {}
        _check_names(dimensions, unknowns, features, units)
        known = (*dimensions, *unknowns)
        self.dimensions = {name: _dimension(name, value) for name, value in dimensions.items()}
        self.description = _Description(
            guesses=tuple((name, _guess(name, value)) for name, value in unknowns.items()),
            loops=tuple(
                read_chain(loop, known, f"Assembly, loop {i + 1}")
                for i, loop in enumerate(members("Assembly: loops", loops, object))
            ),
            equations=tuple(
                read_equation(one, known, f"Assembly, equation {i + 1}")
                for i, one in enumerate(members("Assembly: equations", equations, object))
            ),
            features=tuple((name, _read_feature(name, one, known)) for name, one in features.items()),
            units=tuple(units.items()),
        )
        _check_equations(self.description)

    @property
    def unknowns(self) -> tuple[str, ...]:  # type: ignore[override]
        """The names of the dependent numbers."""
        return tuple(name for name, _ in self.description.guesses)

    @property
    def units(self) -> dict[str, str]:  # type: ignore[override]
        """The units of outputs, as far as they are given."""
        return dict(self.description.units)

    @override
    def guess(self) -> dict[str, float]:
        return dict(self.description.guesses)

    def residual(self, rho: Any) -> list[Float[Array, "..."]]:
        """The resultant of each closed loop, then the residual of each further equation."""
        values = self._values(rho)
        closed = [loop.resultant(values) for loop in self.description.loops]
        return closed + [evaluate(left, values) - evaluate(right, values) for left, right in self.description.equations]

    def outputs(self, rho: Any) -> dict[str, Float[Array, "..."]]:
        """The unknowns and the features."""
        values = self._values(rho)
        features = {
            name: one.resultant(values) if isinstance(one, Chain) else evaluate(one, values)
            for name, one in self.description.features
        }
        return rho._asdict() | features

    def _values(self, rho: Any) -> dict[str, Any]:
        for name, value in self.dimensions.items():
            if jnp.shape(value) != ():
                raise ProblemError(f"Assembly: dimension '{name}' is one number; received shape {jnp.shape(value)}.")
        return self.dimensions | rho._asdict()


def _check_names(
    dimensions: Mapping[str, Any], unknowns: Mapping[str, Any], features: Mapping[str, Any], units: Mapping[str, str]
) -> None:
    seen: dict[str, str] = {}
    by_name = {"dimension": dimensions, "unknown": unknowns, "feature": features}
    for kind, given in {**by_name, "unit": units}.items():
        if not isinstance(given, Mapping):
            raise ProblemError(f"Assembly: expected each {kind} by name, in a dict; received {given!r}.")
    for kind, given in by_name.items():
        for name in given:
            check_name(name, kind)
            if name in seen:
                raise ProblemError(f"Assembly: '{name}' names a {seen[name]} and a {kind}. Rename one of them.")
            seen[name] = kind
    stray = sorted(set(units) - set(unknowns) - set(features))
    if stray:
        raise ProblemError(f"Assembly: units are given for {stray}, which are not unknowns or features.")


def _dimension(name: str, value: Any) -> Any:
    """A number as a float, so that changing it causes no recompilation; distributions and decisions unchanged."""
    if isinstance(value, AbstractLeaf | jax.Array):
        return value
    return _number(value, f"dimension '{name}'", "a finite number, a distribution or a decision")


def _guess(name: str, value: Any) -> float:
    return _number(value, f"the guess of '{name}'", "a finite number near its nominal value")


def _number(value: Any, what: str, expected: str) -> float:
    if isinstance(value, int | float | np.number) and not isinstance(value, bool) and np.isfinite(value):
        return float(value)
    raise ProblemError(f"Assembly: expected {expected} as {what}; received {value!r}.")


def _read_feature(name: str, given: Any, known: Collection[str]) -> Formula | Chain:
    where = f"Assembly, feature '{name}'"
    return read_chain(given, known, where) if is_chain(given) else read_formula(given, known, where)


def _check_equations(description: _Description) -> None:
    """Refuse a wrong number of equations, and unknowns that no equation contains."""
    unknowns = [name for name, _ in description.guesses]
    closed = sum(loop.components for loop in description.loops)
    if closed + len(description.equations) != len(unknowns):
        raise ProblemError(
            f"Assembly: expected as many equations as unknowns, {len(unknowns)} for {unknowns}; received "
            f"{closed + len(description.equations)}: {closed} from {len(description.loops)} closed loops (two from a "
            f"plane loop, three from a spatial one) and {len(description.equations)} others. Add the missing "
            "equations, or turn unknowns into dimensions or dimensions into unknowns."
        )
    formulas = [formula for loop in description.loops for formula in loop.formulas]
    formulas += [side for equation in description.equations for side in equation]
    if any(callable(formula) for formula in formulas):
        return  # the names that a function uses are not known
    used = frozenset[str]().union(*map(names_in, formulas))
    for name in unknowns:
        if name not in used:
            raise ProblemError(f"Assembly: unknown '{name}' is in no loop and no equation. Drop it, or use it.")
