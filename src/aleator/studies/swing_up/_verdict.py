"""The first screen of the page, from the results alone: which swing-up to build, and why."""

from collections.abc import Iterator, Mapping

from aleator.reporting import Card, given, number, percent, share_text
from aleator.studies._motion.build import CALIBRATED
from aleator.studies._motion.facts import duration, violation_cards
from aleator.studies._motion.family import Family
from aleator.studies._motion.results import MotionResults
from aleator.studies.swing_up._facts import FAR, final_spread, missed
from aleator.studies.swing_up._run import ENERGY, EXPECTED, MEAN


def sentences(done: MotionResults, frictionless: Mapping[str, Family]) -> Iterator[str]:
    """Sentences on the plans available, and on the effect of friction."""
    if MEAN in done.evidence and MEAN in done.families:
        yield (
            "Do not use the deterministic plan: flown on the family, it breaks the torque limit in"
            f" {share_text(done.evidence[MEAN].joint)} of the cases and misses the target by more than"
            f" {given(FAR, 'm')} in {share_text(missed(done.families[MEAN]))}."
        )
    if {MEAN, EXPECTED} <= set(done.plans) and EXPECTED in done.evidence:
        more = percent(done.plans[EXPECTED].objective / done.plans[MEAN].objective - 1)
        yield (
            f"The robust plan with the published margin, a = 1, swings the family up with {more} more energy, but "
            f"{share_text(done.evidence[EXPECTED].joint)} of the pendulums need more torque than available."
        )
    if {EXPECTED, ENERGY} <= set(done.plans):
        first, second = (done.plans[name] for name in (EXPECTED, ENERGY))
        yield (
            f"Whether the energy of the expected torque is minimised ({number(first.objective, 4, 'J')} in "
            f"{number(duration(first), 3, 's')}) or the expected energy ({number(second.objective, 4, 'J')} in "
            f"{number(duration(second), 3, 's')}) makes little difference: the torque spreads little where power flows."
        )
    if EXPECTED in frictionless and EXPECTED in done.families:
        with_friction, without = (final_spread(one[EXPECTED]) for one in (done.families, frictionless))
        yield (
            f"With friction the mass matters: the second joint ends with σ = {number(with_friction, 2, 'rad')}; "
            f"without friction all masses swing alike (σ = {number(without, 1, 'rad')}), and only the torque would be "
            "uncertain."
        )


def cards(done: MotionResults) -> Iterator[Card]:
    """The energy of the robust plans, and how often they fail."""
    for name in (EXPECTED, CALIBRATED):
        if plan := done.plans.get(name):
            yield Card(f"Energy, {name}", number(plan.objective, 4, "J"), f"in {number(duration(plan), 3, 's')}")
    yield from violation_cards(done.evidence, (EXPECTED, CALIBRATED), "the torque limit")


def left_below(done: MotionResults) -> str:
    """The share of pendulums that miss upright with the plan to build, which no limit of the problem covers."""
    if CALIBRATED not in done.families:
        return ""
    share = share_text(missed(done.families[CALIBRATED]))
    return f" Of the pendulums flown with it {share} end more than {given(FAR, 'm')} from upright."
