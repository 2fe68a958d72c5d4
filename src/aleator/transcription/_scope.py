"""Statistics of a problem's functionals by least-squares collocation: where its expressions take their numbers."""

from typing import final

from jaxtyping import Array, Float

from aleator import statistics
from aleator.collocation import Collocation, collocate
from aleator.design import AbstractFunctional, AbstractScope, Problem, functionals_of, responses
from aleator.uncertainty import named_numbers

STATISTICS = {"mean": statistics.mean, "std": statistics.std, "variance": statistics.variance}


@final
class ExpansionScope(AbstractScope):
    """Simulates the problem at all collocation points once, and takes every statistic from the coefficients."""

    def __init__(
        self,
        problem: Problem,
        functionals: tuple[AbstractFunctional, ...],
        collocation: Collocation,
        decisions: Float[Array, " n"],
    ):
        self.samples = responses(problem, functionals, collocation.points, decisions)
        self._coefficients = {
            one: collocation.coefficients(values) for one, values in zip(functionals, self.samples, strict=True)
        }
        self._numbers = named_numbers(problem.model, decisions)

    def statistic(self, functional: AbstractFunctional, kind: str) -> Float[Array, "..."]:
        """See `AbstractScope.statistic`."""
        return STATISTICS[kind](self._coefficients[functional])

    def value(self, name: str) -> Float[Array, ""]:
        """See `AbstractScope.value`."""
        return self._numbers[name]


def collocation_of(problem: Problem) -> Collocation:
    """Points and factorised collocation matrix of a problem: once per problem, whatever its decisions."""
    return collocate(problem.survey.germs, problem.expansion)


def scope_of(problem: Problem, collocation: Collocation, decisions: Float[Array, " n"]) -> ExpansionScope:
    """The scope of all expressions of a problem at given decisions."""
    return ExpansionScope(problem, functionals_of(problem.expressions), collocation, decisions)
