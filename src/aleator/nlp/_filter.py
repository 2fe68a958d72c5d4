"""The filter of a line search (Wächter and Biegler 2006, section 2.3): pairs of violation and objective."""

from typing import final

import numpy as np

# Names of the source in brackets.
_LESS_VIOLATION, _LESS_OBJECTIVE = 1e-5, 1e-8  # γ_θ, γ_φ
_ARMIJO = 1e-8  # η_φ
_SWITCH_OBJECTIVE, _SWITCH_VIOLATION = 2.3, 1.1  # s_φ, s_θ
_SHORTEST = 0.05  # γ_α
_LARGEST, _SMALL = 1e4, 1e-4  # θ_max, θ_min over that of the start
_ROUNDINGS = 10 * float(np.finfo(float).eps)


@final
class Filter:
    """Decides which trial points are accepted.

    - `start`: the violation at the start of the search, in the sum of rows.
    """

    def __init__(self, start: float):
        self._largest, self._small = _LARGEST * max(1.0, start), _SMALL * max(1.0, start)
        self._pairs: list[tuple[float, float]] = []

    def clear(self) -> None:
        """Forget all pairs: the objective is another one."""
        self._pairs.clear()

    def shortest(self, violation: float, descent: float) -> float:
        """The step below which there is no hope; `descent`: the slope of the objective along the step."""
        found = _LESS_VIOLATION
        if descent < 0:
            found = min(found, _LESS_OBJECTIVE * violation / -descent)
            if violation <= self._small:
                found = min(found, violation**_SWITCH_VIOLATION / (-descent) ** _SWITCH_OBJECTIVE)
        return max(_SHORTEST * found, _ROUNDINGS)

    def accepts(self, before: tuple[float, float], after: tuple[float, float], descent: float, length: float) -> bool:
        """Whether a trial point is accepted; the pair before it then joins the filter unless the objective falls."""
        (violation, objective), (there, then) = before, after
        slack = _ROUNDINGS * abs(objective)
        if not there <= self._largest or not np.isfinite(then):
            return False
        if any(there >= one and then - other > slack for one, other in self._pairs):
            return False
        falls = descent < 0 and length * (-descent) ** _SWITCH_OBJECTIVE > violation**_SWITCH_VIOLATION
        if falls and violation <= self._small:
            return then - objective - _ARMIJO * length * descent <= slack
        less = there <= (1 - _LESS_VIOLATION) * violation
        if not less and then - objective + _LESS_OBJECTIVE * violation > slack:
            return False
        if not (falls and then - objective - _ARMIJO * length * descent <= slack):
            self._pairs.append(((1 - _LESS_VIOLATION) * violation, objective - _LESS_OBJECTIVE * violation))
        return True
