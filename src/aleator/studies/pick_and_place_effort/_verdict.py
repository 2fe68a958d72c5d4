"""The first screen of the page, from the results alone: which plan of minimum effort to build, and why."""

from collections.abc import Iterator, Mapping

from aleator.reporting import Card, number, percent, share_text
from aleator.studies._motion.build import CALIBRATED
from aleator.studies._motion.facts import violation_cards
from aleator.studies._motion.results import MotionResults
from aleator.studies.pick_and_place_effort._facts import REFERENCE, UNIT, effort_of, pair_text, terminal_spread
from aleator.studies.pick_and_place_effort._run import LEAST, MEAN, ROBUST, WIDE, Spread


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
