"""The first point of a simultaneous program: all that follows from decisions and states."""

import numpy as np
from jaxtyping import Float

from aleator.transcription.simultaneous._layout import Layout
from aleator.transcription.simultaneous._program import Assembled


def started(
    layout: Layout,
    assembled: Assembled,
    decisions: Float[np.ndarray, " n"],
    states: Float[np.ndarray, "realisations points states"],
) -> Float[np.ndarray, " variables"]:
    """The point of a program at some decisions and states: all else follows from them."""
    variables, numbers = np.zeros(layout.count), layout.numbers
    variables[numbers.decisions] = decisions
    variables[np.append(numbers.signals.ravel(), numbers.duration)] = assembled.known(variables)
    variables[numbers.states] = states
    # Each is tied to those before it: what is missing from zero is what it stands for.
    ties = assembled.rows.ties
    for some in layout.stages[1:]:
        these = np.isin(ties.variables, some)
        # What is NaN here makes no start; the rows that are NaN there say where.
        variables[ties.variables[these]] = np.nan_to_num(-assembled.constraints(variables)[ties.rows][these])
    return variables
