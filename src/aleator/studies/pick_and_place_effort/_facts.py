"""The numbers on the page of the effort-optimal study: published and reference values, spreads, a lesson."""

from collections.abc import Mapping

import numpy as np
import scipy

from aleator.reporting import Table, given, number, percent
from aleator.studies._motion.family import Family
from aleator.studies._motion.printed import compared
from aleator.studies._motion.results import MotionResults
from aleator.studies.pick_and_place_effort import TOLERANCE
from aleator.studies.pick_and_place_effort._run import LEAST, MEAN, ROBUST, Spread

REFERENCE = {MEAN: 106.34, ROBUST: 112.12, LEAST: 200.4}
PUBLISHED = {MEAN: 2770.0, ROBUST: 3530.0, LEAST: 5910.0}
SPREADS = {ROBUST: (0.191, 0.133), LEAST: (0.144, 0.114)}
LEAST_REFERENCE = 0.02533
UNIT = "(N m)² s"


def published_table(done: MotionResults) -> Table:
    """Published values and those of an independent program, compared with ours."""
    shown = [name for name in done.plans if name in REFERENCE]
    flown = {name: done.families.get(name) for name in shown}
    efforts = {name: np.nan if one is None else effort_of(one) for name, one in flown.items()}
    first = efforts.get(MEAN, np.nan)
    rows = [
        [
            "Effort over that of the first, published",
            *(number(PUBLISHED[name] / PUBLISHED[MEAN], 3) for name in shown),
        ],
        ["– ours", *(number(efforts[name] / first, 3) for name in shown)],
        [f"Effort, {UNIT}, reference", *(number(REFERENCE[name], 5) for name in shown)],
        [
            "– ours, with limits at the instants",
            *(_unless_least(name, done.coarse[name].objective) if name in done.coarse else "–" for name in shown),
        ],
        ["– ours, between the instants too", *(number(efforts[name], 5) for name in shown)],
        ["Norm of the tip's variances, m², reference", *(_only_least(name, LEAST_REFERENCE) for name in shown)],
        ["– ours", *(_only_least(name, done.plans[name].objective) for name in shown)],
        ["σ of the tip's x and y at the end, m, published", *(pair_text(SPREADS.get(name)) for name in shown)],
        ["– ours", *(pair_text(None if one is None else terminal_spread(one)) for one in flown.values())],
    ]
    note = (
        "Reference: an independent program for the same arm, with limits only at the 61 instants. The published "
        "efforts are sums over an unstated number of samples, for another inertia model, another obstacle and a "
        f"payload with a standard deviation of 0.5 kg. {compared(PUBLISHED, efforts, 'the efforts')}"
    )
    return Table("Published and reference values compared with ours", ["", *shown], rows, note)


def spreads_table(spreads: Mapping[str, Mapping[str, Spread]]) -> Table:
    """The joints' standard deviations at the end by payload: sampled and by the expansion."""
    rows = [
        [f"{name}(t_f), {payload}", number(one.sampled, 3), number(one.expanded, 3), percent(one.error)]
        for payload, ends in spreads.items()
        for name, one in ends.items()
    ]
    header = ["", "σ sampled (rad)", "σ by order 5 (rad)", "Leave-one-out error"]
    note = (
        f"Above {given(100 * TOLERANCE)} % an output counts as unresolved: a solve warns, and means and standard "
        "deviations are not to be trusted."
    )
    return Table("The robust plan with the payload of this study and with a wider one", header, rows, note)


def effort_of(family: Family) -> float:
    """`∫ τ₁² + τ₂² dt` of a plan, (N m)² s, by Simpson's rule on its instants."""
    torques = family.nominal["q1_torque"] ** 2 + family.nominal["q2_torque"] ** 2
    return float(scipy.integrate.simpson(torques, x=family.times))


def terminal_spread(family: Family) -> tuple[float, float]:
    """The standard deviations of the tip's final position, x and y, m."""
    return float(family.systems["tip_x"][:, -1].std()), float(family.systems["tip_y"][:, -1].std())


def _unless_least(name: str, value: float) -> str:
    return "–" if name == LEAST else number(value, 5)


def _only_least(name: str, value: float) -> str:
    return number(value, 4) if name == LEAST else "–"


def pair_text(values: tuple[float, float] | None) -> str:
    """Two numbers: `0.191 and 0.133`."""
    return "–" if values is None else " and ".join(number(one, 3) for one in values)


LESSON = (
    (
        "The dissertation's payload has a standard deviation of 0.5 kg. The same torques then send a light and a heavy "
        "payload to quite different places, and the joint angles as functions of the payload are too strongly curved "
        "for a polynomial of order 5. The expansion's leave-one-out error shows this."
    ),
    "The remedy is feedback, or planning the motion instead of the torques: see the study pick-and-place-time.",
)
