"""The texts of a problem's parts, for reports of its solution."""

from typing import NamedTuple, final

from aleator.design import Problem, functionals_of, statistics_in


@final
class Texts(NamedTuple):
    """The texts of the statistics, functionals and constraints of a problem, in order."""

    statistics: tuple[str, ...]
    functionals: tuple[str, ...]
    constraints: tuple[str, ...]

    @classmethod
    def of(cls, problem: Problem) -> "Texts":
        """Those of a problem."""
        return cls(
            tuple(one.text() for one in statistics_in(problem.expressions)),
            tuple(one.text() for one in functionals_of(problem.expressions)),
            tuple(map(str, problem.constraints)),
        )
