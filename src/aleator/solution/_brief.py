"""A solution in a few words, for lines of progress."""

from aleator.nlp import Status
from aleator.solution._solution import Solution


def in_brief(solution: Solution) -> str:
    """The objective, and whether limits hold and the answer is certified: `objective 3.04, feasible`."""
    if solution.ok:
        return f"objective {solution.objective:.6g}, feasible"
    if solution.status is Status.INFEASIBLE:
        return f"infeasible, violation {solution.certificate.violation:.2g}"
    return solution.status.name.lower().replace("_", " ")
