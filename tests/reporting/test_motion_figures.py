"""Figures of motion: a linkage, paths in the plane and bands, from arrays alone."""

import numpy as np
import pytest

from aleator.reporting import Scene, bands_figure, linkage_animation, looks, plane_figure

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


def test_systems_that_violate_are_counted_in_the_plane():
    joints, broken = turning(RATES), RATES > 1.1
    figure = plane_figure(joints[..., -1, :], joints[0, :, -1], look=LOOK, broken=broken)
    names = [trace.name for trace in figure.data]
    assert f"within the limits ({int((~broken).sum())} of 40 drawn)" in names
    assert f"violating ({int(broken.sum())} of 40 drawn)" in names


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
