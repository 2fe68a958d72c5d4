"""Compilation of the checks of an answer, on another core, in parallel with the program and the search."""

from aleator.certification._reference import prepare_reference
from aleator.certification._second_opinion import prepare_opinion
from aleator.design import Problem
from aleator.transcription import Discretised


def prepare_judges(factor: int, problem: Problem, discretised: Discretised) -> None:
    """Begin to compile the finer grid of `factor` times as many steps, if there is one, and the second opinion."""
    if factor > 1:
        prepare_reference(problem, discretised, factor)
    prepare_opinion(problem)
