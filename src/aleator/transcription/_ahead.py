"""What judges an answer, compiled on another core beside the program and the search for it."""

from aleator.design import Problem
from aleator.expansion import Collocation
from aleator.statistics import Constants
from aleator.transcription._reference import prepare_reference
from aleator.transcription._second_opinion import prepare_opinion


def prepare_judges(factor: int, problem: Problem, collocation: Collocation, constants: Constants) -> None:
    """Begin to compile the grid of `factor` times as many steps, if there is one, and the second opinion."""
    if factor > 1:
        prepare_reference(problem, collocation, constants, factor)
    prepare_opinion(problem)
