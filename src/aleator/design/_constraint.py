"""`Constraint`: an expression between bounds, under a name."""

from typing import Self, final

import equinox as eqx
import numpy as np

from aleator._core.arrays import Scalar
from aleator._core.errors import ProblemError
from aleator.design._expression import Expression, Statistic, as_expression


@final
class Constraint(eqx.Module):
    """`lower <= expression <= upper`, at every instant if a `path` stands in the expression.

    Constraints of one `name` belong together: a sweep moves their bounds together, evidence counts a system that
    violates any of them once. The bounds are data: changing them compiles nothing anew.

    Raises `ProblemError` for bounds in the wrong order or not a number.
    """

    expression: Expression
    lower: Scalar
    upper: Scalar
    name: str = eqx.field(static=True)

    def __init__(
        self,
        expression: Expression,
        *,
        lower: Scalar = -np.inf,
        upper: Scalar = np.inf,
        name: str | None = None,
    ):
        self.expression = as_expression(expression)
        self.name = name or _default_name(self.expression)
        self.lower, self.upper = ordered(self.name, lower, upper)

    def named(self, name: str) -> "Constraint":
        """The same constraint under a name of your own."""
        return Constraint(self.expression, lower=self.lower, upper=self.upper, name=name)

    def with_bounds(self, lower: float, upper: float) -> Self:
        """The same constraint between other bounds. Open sides stay open and closed ones closed."""
        return eqx.tree_at(lambda tree: (tree.lower, tree.upper), self, ordered(self.name, lower, upper))

    @property
    def is_path(self) -> bool:
        """Whether it holds at every instant."""
        from aleator.design._functional import Path

        return any(isinstance(atom, Statistic) and isinstance(atom.functional, Path) for atom in self.expression.atoms)

    def __bool__(self) -> bool:
        raise ProblemError(
            "A constraint has no truth value: a chain such as 'lower <= y <= upper' does not work in Python and would "
            "lose its first half. Write two comparisons, or use .within(lower, upper)."
        )

    def __str__(self) -> str:
        lower, upper = float(self.lower), float(self.upper)
        if lower == upper:
            relation = f"{self.expression} = {upper:g}"
        else:
            below = f"{lower:g} ≤ " if np.isfinite(lower) and np.isfinite(upper) else ""
            above = f" ≤ {upper:g}" if np.isfinite(upper) else f" ≥ {lower:g}"
            relation = f"{below}{self.expression}{above}"
        return f"{relation} for all t" if self.is_path else relation


def ordered(name: str, lower: Scalar, upper: Scalar) -> tuple[float, float]:
    """The bounds as floats. Raises `ProblemError` if they are in the wrong order or not a number."""
    lower, upper = float(lower), float(upper)
    if np.isnan(lower) or np.isnan(upper) or lower > upper:
        raise ProblemError(
            f"Constraint '{name}': expected lower <= upper; received lower={lower:g}, upper={upper:g}. Swap them."
        )
    return lower, upper


def _default_name(expression: Expression) -> str:
    """The outputs (or numbers) that a constraint speaks of."""
    names = (
        atom.functional.output if isinstance(atom, Statistic) else getattr(atom, "name", "")
        for atom in expression.atoms
    )
    return ", ".join(dict.fromkeys(names)) or "constant"
