"""`total`: the sum of signals."""

from collections.abc import Iterable
from typing import Any, final

import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.trajectories import AbstractSignal


@final
class Total(AbstractSignal):
    """The sum of signals; see `total`. Its numbers are named after their signal's place: `inputs.force.parts.0...`."""

    parts: tuple[AbstractSignal, ...]

    def __init__(self, parts: Iterable[AbstractSignal]):
        self.parts = tuple(parts)
        for part in self.parts:
            if not isinstance(part, AbstractSignal):
                raise ProblemError(
                    "total: expected signals, such as al.processes.total(command, noise); received "
                    f"{type(part).__name__} {part!r}. Make a constant or a function of time a signal with "
                    "al.processes.signal."
                )
        if not self.parts:
            raise ProblemError("total: expected at least one signal; received none.")
        self.span()

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        first, *others = (part(t) for part in self.parts)
        return sum(others, start=first)

    @override
    def over(self, t_start: Any, t_final: Any) -> "Total":
        return Total(part.over(t_start, t_final) for part in self.parts)

    @override
    def sampled(self, fractions: Float[np.ndarray, " n"], t_start: Any, t_final: Any) -> Float[Array, "n ..."]:
        first, *others = (part.sampled(fractions, t_start, t_final) for part in self.parts)
        return sum(others, start=first)

    @override
    def span(self) -> tuple[float, float]:
        return common_span(part.span() for part in self.parts)


def total(*signals: AbstractSignal) -> Total:
    """The sum of signals: a command and the actuator's noise, a mean road and its roughness.

    Raises `ProblemError` for arguments that are not signals, and for signals with no common time.
    """
    return Total(signals)


def common_span(spans: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """The times that lie in all spans. Raises `ProblemError` if there are none."""
    spans = tuple(spans)
    first, last = max(start for start, _ in spans), min(end for _, end in spans)
    if not first < last:
        known = " and ".join(f"from {start:g} to {end:g} s" for start, end in spans)
        raise ProblemError(f"Signals that are added must be known at the same times; received signals known {known}.")
    return first, last
