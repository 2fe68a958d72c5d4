"""`PowerSeries`: one polynomial over the whole duration, from conditions at the ends and at a point in between."""

import math
from typing import Any, ClassVar, final

import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import in_library, jax_array
from aleator._core.errors import ProblemError
from aleator._core.leaves import highest, lowest
from aleator.trajectories._trajectory import AbstractTrajectory, Fractions, as_array, conditions, copied, shape_of

_KIND = "PowerSeries"


@final
class PowerSeries(AbstractTrajectory):
    """The polynomial `a_1 + a_2 t + a_3 t² + ...` (equation 50) that meets its conditions (equation 51).

    - `start`, `end`: `(value, velocity, acceleration)` there, or the first one or two of them;
    - `middle`: the value at one more instant, such as a `Decision`, or None; `middle_time`: that instant, as a fraction
      of the duration: a number strictly between 0 and 1, or a distribution or `Decision` in that range.

    There are as many coefficients as conditions. Raises `ProblemError` for conditions of different shapes, and for a
    middle time that can reach an end.
    """

    start: tuple[Any, ...]
    end: tuple[Any, ...]
    middle: Any
    middle_time: Any

    curve_fields: ClassVar[tuple[str, ...]] = ("start", "end", "middle")

    def __init__(self, *, start: Any, end: Any = (), middle: Any = None, middle_time: Any = 0.5):
        values = start if isinstance(start, list | tuple) else (start,)
        if not values:
            raise ProblemError(f"{_KIND}: expected at least a value at the start; received none.")
        shape = shape_of(values[0])
        self.start = conditions(_KIND, "start", start, shape)
        self.end = conditions(_KIND, "end", end, shape)
        self.middle = None if middle is None else copied(_KIND, "middle", middle)
        if middle is not None and shape_of(self.middle) != shape:
            raise ProblemError(f"{_KIND}: expected a middle of shape {shape}; received {shape_of(self.middle)}.")
        self.middle_time = copied(_KIND, "middle time", middle_time)
        _check_inside(self.middle_time)

    @property
    @override
    def shape(self) -> tuple[int, ...]:
        return shape_of(self.start[0])

    @override
    def values(self, fractions: Fractions, duration: Any = 1.0, order: int = 0) -> Float[Array, "n ..."]:
        coefficients = self.coefficients(duration)
        library, fractions, coefficients, duration = in_library(fractions, coefficients, duration)
        powers = _powers(fractions, len(coefficients), order)
        return jax_array(library.tensordot(powers, coefficients, axes=1) / duration**order)

    def coefficients(self, duration: Any = 1.0) -> Float[Array, "n ..."]:
        """The coefficients in powers of the fraction of the duration, from the linear system (51)."""
        ends = [(0.0, order, value) for order, value in enumerate(self.start)]
        ends += [(1.0, order, value) for order, value in enumerate(self.end)]
        inner = [] if self.middle is None else [(self.middle_time, 0, self.middle)]
        count = len(ends) + len(inner)
        places, orders, values = zip(*ends, *inner, strict=True)
        library, places, values, duration = in_library(*([*map(as_array, each)] for each in (places, values)), duration)
        rows = [_powers(place[None], count, order)[0] for place, order in zip(places, orders, strict=True)]
        wanted = [value * duration**order for value, order in zip(values, orders, strict=True)]
        right = library.stack(wanted).reshape(count, -1)
        return jax_array(library.linalg.solve(library.stack(rows), right).reshape(count, *self.shape))


def _powers(u: Fractions, count: int, order: int) -> Float[np.ndarray | Array, "n count"]:
    """Derivatives of some order of the powers 0 to `count - 1` of `u`."""
    library, u = in_library(u)
    terms = [
        math.perm(power, order) * u ** (power - order) if power >= order else library.zeros_like(u)
        for power in range(count)
    ]
    return library.stack(terms, axis=1)


def _check_inside(time: Any) -> None:
    known = [end for end in (lowest(time), highest(time)) if end is not None]
    if shape_of(time) != () or not all(0 < end < 1 for end in known):
        raise ProblemError(
            f"{_KIND}: expected a middle time strictly between 0 and 1, as a fraction of the duration, or a "
            f"distribution or a Decision in that range; received {time!r}."
        )
