"""Which plan of least effort to build, and why: the first screen of the page, from the results alone."""

from collections.abc import Iterator, Mapping

from aleator.reporting import Card, number, percent, share_text
from aleator.studies._motion.build import CALIBRATED
from aleator.studies._motion.facts import violation_cards
from aleator.studies._motion.results import MotionResults
from aleator.studies.pick_and_place_effort._facts import REFERENCE, UNIT, effort_of, pair_text, terminal_spread
from aleator.studies.pick_and_place_effort._run import LEAST, MEAN, ROBUST, WIDE, Spread


def sentences(done: MotionResults, spreads: Mapping[str, Mapping[str, Spread]]) -> Iterator[str]:
    """What there is to say of the plans there are, and of how far the joints spread at the end, by payload."""
    families = done.families
    if {MEAN, ROBUST} <= set(done.evidence):
        mean, robust = (done.evidence[name].violations["obstacle"] for name in (MEAN, ROBUST))
        yield (
            "The deterministic plan grazes the obstacle with the mean payload, so that"
            f" {share_text(mean)} of all payloads hit it. One σ of clearance, as printed, leaves"
            f" {share_text(robust)}: the share of payloads that a uniform distribution has beyond one σ on one side is"
            " 21.1 %."
        )
    if {ROBUST, LEAST} <= set(families):
        robust, least = (terminal_spread(families[name]) for name in (ROBUST, LEAST))
        efforts = [effort_of(families[name]) for name in (ROBUST, LEAST)]
        yield (
            f"At the end the tip spreads by σ = {pair_text(robust)} m in x and y. The most that torques can do,"
            f" with {number(efforts[1] / efforts[0], 3)} times the effort, is {pair_text(least)} m: no open-loop"
            " plan brings it to zero."
        )
    if wide := spreads.get(str(WIDE)):
        spread, error = (max(parts) for parts in zip(*((one.sampled, one.error) for one in wide.values()), strict=True))
        yield (
            f"With payloads that spread five times as much a joint ends with σ = {number(spread, 2, 'rad')}, and"
            f" order 5 misses a new payload by {percent(error)} of it: there the expansion must not be trusted."
        )


def cards(done: MotionResults) -> Iterator[Card]:
    """What the robust plans take, and how often they fail."""
    plans = done.plans
    if ROBUST in plans:
        note = f"margin a = 1; reference {REFERENCE[ROBUST]}"
        yield Card(f"Effort, {ROBUST}", number(plans[ROBUST].objective, 4, UNIT), note)
    if CALIBRATED in plans and done.calibration is not None:
        note = f"margin a = {number(done.calibration.sigmas, 3)}"
        yield Card(f"Effort, {CALIBRATED}", number(plans[CALIBRATED].objective, 4, UNIT), note)
    yield from violation_cards(done.evidence, (ROBUST, CALIBRATED), "a limit")


def left_to_feedback(done: MotionResults) -> str:
    """What clearance does not do: it does not bring every payload to its place."""
    if CALIBRATED not in done.families:
        return ""
    spread = pair_text(terminal_spread(done.families[CALIBRATED]))
    return f" At the end its tip spreads by σ = {spread} m in x and y: feedback has to do the rest."
