"""The first screen of the page, from the results alone: which of the fastest plans to run, and why."""

from collections.abc import Iterator

from aleator.reporting import Card, count, given, interval, number, percent, share_text
from aleator.studies._motion.build import TARGET, price
from aleator.studies._motion.facts import duration, violation_cards
from aleator.studies._motion.results import MotionResults
from aleator.studies.pick_and_place_time._facts import predicted_share
from aleator.studies.pick_and_place_time._run import MEAN, ONE, WORST


def worst_case_holds(done: MotionResults) -> bool:
    """Whether fresh payloads confirm that the worst-case plan breaks no limit."""
    found = done.evidence[WORST].joint
    return found.upper <= TARGET and not found.count


def worst_case_broken(done: MotionResults) -> str:
    """How often the worst-case plan breaks a limit."""
    return (
        f" The plan with a = √3 is not safe either: {share_text(done.evidence[WORST].joint)} of the payloads break a "
        "limit."
    )


def headline(done: MotionResults) -> str:
    """The worst-case plan, its cost, and the time saved by tolerating a few violations."""
    plan, one, found = done.plans[WORST], done.plans[ONE], done.evidence[WORST].joint
    said = (
        f"The worst-case plan, a = √3, for {price(duration(plan), duration(one), 's')}: none of"
        f" {count(found.samples)} payloads breaks a limit [{interval(found)}, target {given(100 * TARGET)} %]."
    )
    if done.calibration is None:
        return said
    less = duration(plan) - duration(done.calibration.solution)
    return f"{said} A margin of a = {number(done.calibration.sigmas, 4)} would save {number(1000 * less, 2, 'ms')}."


def sentences(done: MotionResults) -> Iterator[str]:
    """Sentences on the plans available."""
    if one := done.evidence.get(MEAN):
        yield (
            "Do not run the plan for the mean payload: it drives the torques to their limits, and "
            f"{share_text(one.joint)} of the payloads need more."
        )
    if one := done.evidence.get(ONE):
        yield (
            f"The published margin of one σ is not safe: {share_text(one.joint)} of the payloads overload a joint. "
            f"This agrees with theory: {percent(predicted_share(1.0))} of uniform payloads lie outside μ ± σ."
        )
    if (found := done.calibration) is not None:
        yield (
            f"If {given(100 * found.target)} % of the payloads may fail, a = {number(found.sigmas, 4)}, in"
            f" {number(duration(found.solution), 4, 's')}, is {found.sentence('payloads')}."
        )


def cards(done: MotionResults) -> Iterator[Card]:
    """The durations of the robust plans, and how often they fail."""
    notes = {ONE: "the published margin", WORST: "fastest for all payloads"}
    for name, note in notes.items():
        if plan := done.plans.get(name):
            yield Card(f"Duration, {name}", number(duration(plan), 4, "s"), note)
    yield from violation_cards(done.evidence, (ONE, WORST), "a limit")
