"""Figures of reports: trajectories and calibrations show the numbers that they are of."""

import dataclasses

import numpy as np
import pytest
import report_problems as given

from aleator.reporting import (
    calibration_figure,
    interval,
    percent,
    trajectory_figure,
)
from aleator.reporting._paths import curves


def traces(figure, mode):
    return [one for one in figure.data if one.mode == mode and one.x is not None and one.x[0] is not None]


def numbers(values):
    return np.array(values, dtype=float)


def test_trajectories_are_those_kept_and_the_title_gives_the_share_with_its_interval():
    evidence = given.evidence()
    figure = trajectory_figure(evidence, given.NAME, unit="m", every=1)
    (kept,) = evidence.trajectories
    drawn = np.concatenate([numbers(one.y) for one in traces(figure, "lines")])
    drawn = drawn[np.isfinite(drawn)]
    np.testing.assert_allclose(np.sort(drawn), np.sort(kept.values.ravel()), rtol=1e-6)
    share = evidence.violations[given.NAME]
    assert figure.layout.title.text.startswith(f"{percent(share.estimate)} [{interval(share)}]")
    assert sum("violating" in (one.name or "") for one in traces(figure, "lines")) == 1
    assert [shape.y0 for shape in figure.layout.shapes] == [0.2]
    # A vector over time is drawn component by component.
    lines, violating = curves(np.arange(12.0).reshape(2, 3, 2), np.array([True, False]))
    np.testing.assert_array_equal(lines, [[0, 2, 4], [1, 3, 5], [6, 8, 10], [7, 9, 11]])
    np.testing.assert_array_equal(violating, [True, True, False, False])


def test_a_calibration_shows_every_trial_with_its_interval_and_the_target():
    calibration = given.calibration()
    figure = calibration_figure(calibration)
    trials = sorted(calibration.trials, key=lambda one: one.sigmas)
    np.testing.assert_allclose(figure.data[0].x, [one.sigmas for one in trials])
    np.testing.assert_allclose(figure.data[0].y, [100 * one.violation.estimate for one in trials])
    upper = np.array(figure.data[0].y) + np.array(figure.data[0].error_y.array)
    np.testing.assert_allclose(upper, [100 * one.violation.upper for one in trials])
    assert figure.layout.shapes[0].y0 == pytest.approx(10.0)
    assert figure.data[1].y == (100 * calibration.confirmation.estimate,)
    unconfirmed = dataclasses.replace(calibration, confirmation=None, missing="it was interrupted")
    assert len(calibration_figure(unconfirmed).data[1].x) == 0
