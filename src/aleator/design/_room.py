"""The memory that the histories of a problem need, estimated before anything is simulated."""

from aleator._core.arrays import NUMBER, refuse_beyond_memory
from aleator.design._declaration import AbstractProblem
from aleator.design._functionals import AbstractIntegral
from aleator.design._statistic import functionals_of


def refuse_large_histories(problem: AbstractProblem, systems: int, derivatives: int, advice: str) -> None:
    """Raise `ProblemError` if the outputs of `systems` systems would not fit into memory together.

    Outputs are stored at every instant where a functional needs them there, each with its `derivatives`.
    """
    histories = [one for one in functionals_of(problem.expressions) if not isinstance(one, AbstractIntegral)]
    outputs = len({name for one in histories for name in one.outputs})
    instants = problem.grid.steps + 1
    what = f"{systems} systems with {outputs} outputs at {instants} instants"
    what += f" and their derivatives by {derivatives} decisions" if derivatives else ""
    refuse_beyond_memory(what, NUMBER * systems * outputs * instants * (1 + derivatives), advice)
