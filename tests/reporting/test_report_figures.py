"""Figures of reports: fronts, trajectories, percentiles and calibrations show the numbers that they are of."""

import dataclasses
import html

import numpy as np
import pytest
import report_problems as given

from aleator.reporting import (
    Scene,
    bands_figure,
    calibration_figure,
    front_figure,
    interval,
    linkage_animation,
    looks,
    percent,
    percentile_figure,
    relative_figure,
    shadow_price_figure,
    trajectory_figure,
)
from aleator.reporting._paths import curves


def traces(figure, mode):
    return [one for one in figure.data if one.mode == mode and one.x is not None and one.x[0] is not None]


def numbers(values):
    return np.array(values, dtype=float)


def test_a_front_is_drawn_at_its_values_and_optima_filled_where_its_bound_is_active():
    front = given.front()
    figure = front_figure({"uOpt": front}, x="Reach", x_unit="m", y="Effort", y_unit="m²/s³")
    (line,) = traces(figure, "lines+markers")
    np.testing.assert_allclose(line.x, front.values)
    np.testing.assert_allclose(numbers(line.y), front.objectives)
    assert figure.layout.xaxis.title.text == "Reach (m)"
    assert figure.layout.yaxis.title.text == "Effort (m²/s³)"
    filled = [not symbol.endswith("-open") for symbol in line.marker.symbol]
    assert filled[:3] == [one.multiplier(given.NAME) > 0 for one in front.solutions][:3] == [False, True, True]
    # Infeasible points stand on the axis and say why.
    (crosses,) = traces(figure, "markers+text")
    np.testing.assert_allclose(crosses.x, front.values[~front.solved])
    assert "infeasible" in crosses.text[0]
    assert html.escape(front.solutions[-1].violated[0].sentence(), quote=False) in crosses.customdata[0]
    assert figure.layout.yaxis.range[0] < crosses.y[0] < np.nanmin(front.objectives)


def test_shadow_prices_and_decisions_along_a_front_are_in_the_unit_asked():
    front = given.front()
    (line,) = shadow_price_figure({"uOpt": front}, x="Reach", y="Shadow price", scale=0.01).data
    np.testing.assert_allclose(numbers(line.y[:3]), 0.01 * front.shadow_prices[:3])
    (line,) = relative_figure(front, {"c.mean": "damper"}, x="Reach", y="Share").data
    chosen = [float(one.decisions["c.mean"]) for one in front.solutions[:3]]
    np.testing.assert_allclose(numbers(line.y[:3]), 100 * np.array(chosen))  # of a start of one


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


def test_percentiles_and_means_are_those_sampled():
    sampled = given.evidence().functionals["∫effort dt"]
    figure = percentile_figure({"design": sampled}, x="Effort", unit="m²/s³", limit=15.0)
    np.testing.assert_allclose(traces(figure, "lines")[0].x, sampled.percentiles[[0, -1]])
    assert float(sampled.mean) in [one.x[0] for one in traces(figure, "markers")]


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


# --- Figures of motion ------------------------------------------------------------------------------------------------


LOOK = looks(["robust"])["robust"]
TIMES = np.linspace(0.0, 2.0, 201)
RATES = np.linspace(0.8, 1.2, 40)


def turning(rates):
    """Two links of lengths 1 and 0.5 that turn together, at each rate: base, elbow and tip."""
    angles = rates[:, None] * TIMES[None]
    ray = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.stack([0 * ray, ray, 1.5 * ray], axis=-2)


def test_links_keep_their_lengths_in_every_frame_from_the_first_instant_to_the_last():
    scene, mean = Scene(((1.0, 1.0, 0.25),), wall=-1.5), turning(np.ones(1))[0]
    animation = linkage_animation(TIMES, turning(RATES), mean, look=LOOK, scene=scene, target=(0.0, 1.5))
    assert len(animation.frames) == 60
    assert [animation.frames[0].name, animation.frames[-1].name] == ["0.00", "2.00"]
    for frame in animation.frames:
        cloud, nominal = frame.data
        points = np.array([nominal.x, nominal.y], dtype=float).T
        np.testing.assert_allclose(np.linalg.norm(np.diff(points, axis=0), axis=1), [1.0, 0.5], atol=2e-3)
        assert sum(x is None for x in cloud.x) == 25
    steps = animation.layout.sliders[0].steps
    assert [step.args[0][0] for step in steps] == [frame.name for frame in animation.frames]
    assert {trace for frame in animation.frames for trace in frame.traces} == {1, 2}


def test_the_bands_reach_one_sigma_and_the_whole_range():
    rows = RATES[:, None] * np.sin(TIMES)[None]
    figure = bands_figure(TIMES, {"q": rows}, y="Angle", unit="rad", limits=(-1.0, 1.0), targets={"q": 0.0})
    top = int(np.argmax(np.sin(TIMES)))
    wide, narrow, mean = figure.data[:3]
    assert wide.y[top] == pytest.approx(1.2, rel=1e-4)
    # The standard deviation of 40 equidistant numbers over a width of 0.4.
    sigma = 0.4 * np.sqrt((40 + 1) / (12 * (40 - 1)))
    assert narrow.y[top] - mean.y[top] == pytest.approx(sigma, rel=1e-3)
    assert len(figure.layout.shapes) == 2
    assert figure.data[3].y == (0.0,)
