"""Numbers and tables of the effort-optimal study, and its verdict: which plan to build, and why."""

from collections.abc import Iterator, Mapping

import numpy as np
import scipy

from aleator.reporting import Card, Table, given, number, percent, share_text
from aleator.studies._motion.facts import CALIBRATED, compared, violation_cards
from aleator.studies._motion.results import Family, MotionResults
from aleator.studies.pick_and_place_effort import TOLERANCE
from aleator.studies.pick_and_place_effort._run import LEAST, MEAN, ROBUST, WIDE, Spread

REFERENCE = {MEAN: 106.34, ROBUST: 112.12, LEAST: 200.4}
PUBLISHED = {MEAN: 2770.0, ROBUST: 3530.0, LEAST: 5910.0}
SPREADS = {ROBUST: (0.191, 0.133), LEAST: (0.144, 0.114)}
LEAST_REFERENCE = 0.02533
UNIT = "(N m)² s"
LESSON = (
    (
        "The dissertation's payload has a standard deviation of 0.5 kg. The same torques then send a light and a heavy "
        "payload to quite different places, and the joint angles as functions of the payload are too strongly curved "
        "for a polynomial of order 5. The expansion's leave-one-out error shows this."
    ),
    "The remedy is feedback, or planning the motion instead of the torques: see the study pick-and-place-time.",
)


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


def sentences(done: MotionResults, spreads: Mapping[str, Mapping[str, Spread]]) -> Iterator[str]:
    """Sentences on the plans available, and on the joints' spread at the end by payload."""
    families = done.families
    if {MEAN, ROBUST} <= set(done.evidence):
        mean, robust = (done.evidence[name].violations["obstacle"] for name in (MEAN, ROBUST))
        yield (
            f"The deterministic plan grazes the obstacle with the mean payload, so that {share_text(mean)} of all "
            f"payloads hit it. With one σ of clearance, as published, {share_text(robust)} hit it: for a uniform "
            "distribution 21.1 % of the payloads lie beyond one σ on one side."
        )
    if {ROBUST, LEAST} <= set(families):
        robust, least = (terminal_spread(families[name]) for name in (ROBUST, LEAST))
        efforts = [effort_of(families[name]) for name in (ROBUST, LEAST)]
        yield (
            f"At the end the tip has σ = {pair_text(robust)} m in x and y. The best that torques can achieve, with "
            f"{number(efforts[1] / efforts[0], 3)} times the effort, is {pair_text(least)} m: no open-loop plan brings "
            "it to zero."
        )
    if wide := spreads.get(str(WIDE)):
        spread, error = (max(parts) for parts in zip(*((one.sampled, one.error) for one in wide.values()), strict=True))
        yield (
            f"With five times the spread of payloads a joint ends with σ = {number(spread, 2, 'rad')}, and order 5 "
            f"misses a new payload by {percent(error)} of it: there the expansion must not be trusted."
        )


def cards(done: MotionResults) -> Iterator[Card]:
    """The cost of the robust plans, and how often they fail."""
    plans = done.plans
    if ROBUST in plans:
        note = f"margin a = 1; reference {REFERENCE[ROBUST]}"
        yield Card(f"Effort, {ROBUST}", number(plans[ROBUST].objective, 4, UNIT), note)
    if CALIBRATED in plans and done.calibration is not None:
        note = f"margin a = {number(done.calibration.sigmas, 3)}"
        yield Card(f"Effort, {CALIBRATED}", number(plans[CALIBRATED].objective, 4, UNIT), note)
    yield from violation_cards(done.evidence, (ROBUST, CALIBRATED), "a limit")


def left_to_feedback(done: MotionResults) -> str:
    """The remaining spread at the end, which clearance does not reduce."""
    if CALIBRATED not in done.families:
        return ""
    spread = pair_text(terminal_spread(done.families[CALIBRATED]))
    return f" At the end its tip has σ = {spread} m in x and y: feedback has to do the rest."
