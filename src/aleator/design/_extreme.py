"""`Extreme`: the worst value of a functional over realisations of the model, as a term of a limit."""

from typing import Any, final

import equinox as eqx
from jaxtyping import Array
from typing_extensions import override

from aleator.design._expression import Constraint, Expression
from aleator.design._scope import AbstractAtom, AbstractScope, Units


@final
class Extreme(AbstractAtom):
    """The largest (`side = 1`) or smallest (`side = -1`) value of a functional over realisations of the model.

    These are all that its distributions allow, or those at the collocation points alone (`at_points`). It evaluates to
    the functional on each realisation available: a bound on it is a bound on each of them.
    """

    functional: Any
    side: int = eqx.field(static=True)
    at_points: bool = eqx.field(static=True, default=False)

    @override
    def evaluate(self, scope: AbstractScope) -> Array:
        return scope.realised(self.functional)

    @override
    def text(self) -> str:
        return f"{'max' if self.side > 0 else 'min'}{'_k' if self.at_points else ''}[{self.functional.text()}]"

    @override
    def unit(self, units: Units) -> str:
        return self.functional.unit(units.outputs)

    @property
    @override
    def subjects(self) -> tuple[str, ...]:
        return self.functional.outputs

    @property
    def functionals(self) -> tuple[Any, ...]:
        """The functional, in a tuple as for statistics."""
        return (self.functional,)

    @property
    @override
    def measures(self) -> tuple[str, ...]:
        return (self.functional.text(),)

    @property
    @override
    def is_path(self) -> bool:
        return self.functional.is_path


def is_worst_case(constraint: Constraint) -> bool:
    """Whether a constraint bounds the worst realisation of the model."""
    return any(isinstance(atom, Extreme) and not atom.at_points for atom in constraint.expression.leaves)


def is_at_points(constraint: Constraint) -> bool:
    """Whether a constraint bounds the realisations at the collocation points."""
    return any(isinstance(atom, Extreme) and atom.at_points for atom in constraint.expression.leaves)


def extreme_functionals(expressions: tuple[Expression, ...]) -> tuple[Any, ...]:
    """The functionals whose worst case appears in the expressions, each once."""
    leaves = (leaf for one in expressions for leaf in one.leaves)
    return tuple(dict.fromkeys(leaf.functional for leaf in leaves if isinstance(leaf, Extreme)))
