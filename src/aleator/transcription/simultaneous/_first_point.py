"""The first point of a simultaneous program: all that follows from decisions and simulated states."""

import numpy as np
from jaxtyping import Float

from aleator.design import Problem
from aleator.transcription.simultaneous._layout import Layout
from aleator.transcription.simultaneous._program import Assembled
from aleator.transcription.simultaneous._start import simulated_states


def started(
    layout: Layout,
    assembled: Assembled,
    problem: Problem,
    points: Float[np.ndarray, "realisations germs"],
    decisions: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " variables"]:
    """The point of a program at some decisions: states as simulated, all else as it follows from them."""
    variables, numbers = np.zeros(layout.count), layout.numbers
    variables[numbers.decisions] = decisions
    known = assembled.blocks(variables)[0][: numbers.signals.size + 1]
    variables[np.append(numbers.signals.ravel(), numbers.duration)] = known
    variables[numbers.states] = simulated_states(problem, layout.plan.mesh, points, decisions)
    # Each is tied to those before it: what is missing from zero is what it stands for.
    ties = assembled.rows.ties
    for some in layout.stages[1:]:
        these = np.isin(ties.stands_for, some)
        variables[ties.stands_for[these]] = -assembled.constraints(variables)[ties.where][these]
    return variables
