"""Whether the numbers of a design are still correlated as was given: a copula stays while decisions set shapes."""

import numpy as np
from jaxtyping import Float

from aleator.design import Problem
from aleator.uncertainty import correlations_at

# Differences that no data would show.
_TOLERATED = 0.01


def moved_correlations(problem: Problem, decisions: Float[np.ndarray, " n"]) -> str:
    """Which correlations differ from those given, in a sentence; empty if none does."""
    places = problem.placements
    if not any(one.dependence is not None and one.shape_is_decided for one in places.distributions.values()):
        return ""
    given, now = (correlations_at(places, one) for one in (places.vector("initial"), decisions))
    moved = [pair for pair in given if not abs(now[pair] - given[pair]) <= _TOLERATED]
    if not moved:
        return ""
    texts = ", ".join(
        f"{now[pair]:.3g} between {' and '.join(pair)} in the place of {given[pair]:.3g}" for pair in moved
    )
    return (
        f"at this design correlations are {texts}: a decision sets a shape, and a copula keeps to the shapes in which "
        "it was made. Make it with this design as the initial values of its decisions, and solve again"
    )
