"""A calibration is confirmed by systems that had no part in it."""

import aleator as al
from zoo import bar_problem


def test_the_systems_that_confirm_a_margin_are_not_those_by_which_it_was_chosen():
    found = al.calibrate(bar_problem(), "stress", 0.2, samples=2000, max_trials=6)
    assert found.confirmed
    assert found.evidence.seed != 0
    # As many systems as in a trial, by the seed of the confirmation, would be those of the trial itself.
    again = al.validate(found.solution, found.chosen.violation.samples, seed=found.evidence.seed)
    assert again.violations["stress"].count != found.chosen.violation.count
