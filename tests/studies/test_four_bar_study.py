"""The four-bar study: its linkage against closed forms and elimination, and its designs against counts."""

from functools import cache

import numpy as np
import pytest

import aleator as al
from aleator import extending as ext
from aleator.studies import load
from aleator.studies._shared import TARGET
from aleator.studies.four_bar import DURATION, HEIGHT, LENGTHS, WIDTHS, ZONE, FourBar, driven
from aleator.studies.four_bar._chapter import ALLOCATED, HOEKEN, NOMINAL, ROBUST
from compiling import compiled
from four_bar_elimination import count_linkages, crank_angles, posture, posture_of

PLAYS, SEATS = {"crank": 0.05, "rocker": 0.08}, {"crank": (0.3, -0.4), "rocker": (-0.6, 0.2)}
BARS = ("crank", "coupler", "rocker")
UNEVEN = {**dict(zip(BARS, (95.0, 265.0, 270.0), strict=True)), "ground": 211.0, "along": 533.0, "across": 7.0}


def hoeken(ground, bar, angles):
    """The tool of Hoeken's linkage of crank 1, coupler and rocker `bar`, the tool at twice that.

    The tool, the crank's pin and the rocker's bearing lie on a circle about the rocker's pin: the angle at the bearing
    is right, and the tool lies at sqrt((2 bar)^2 - f^2) from it, f being the distance to the crank's pin (Thales).
    """
    f = np.sqrt(1 + ground**2 - 2 * ground * np.cos(angles))
    out = np.sqrt(4 * bar**2 - f**2) / f
    return ground + out * np.sin(angles), out * (ground - np.cos(angles))


def test_elimination_is_the_right_angle_of_thales():
    lengths = {"crank": 1.0, "coupler": 2.5, "rocker": 2.5, "ground": 2.0, "along": 5.0, "across": 0.0}
    angles = np.linspace(0.1, 6.0, 50)
    np.testing.assert_allclose(posture_of(lengths, angles).tool.T, hoeken(2.0, 2.5, angles), rtol=1e-12)
    # The proportions 2 : 4 : 5 : 5 cross the height of four cranks at both ends of half a turn and in its middle.
    np.testing.assert_allclose(hoeken(2.0, 2.5, np.radians([90, 180, 270]))[1], 4.0, rtol=1e-14)


@compiled
def run(system):
    return al.simulate(system, al.Grid(DURATION, 20))


@cache
def simulated():
    played = {f"{pin}_play": PLAYS[pin] for pin in PLAYS} | {f"{pin}_seat": SEATS[pin] for pin in SEATS}
    model = FourBar(zone=1.0, **UNEVEN, **played)
    return {name: np.asarray(values) for name, values in run(driven(model)).items()}


@pytest.mark.slow
def test_the_path_of_the_closed_loop_is_that_of_elimination():
    offsets = (PLAYS[pin] * np.array(SEATS[pin]) for pin in PLAYS)
    lengths = {name: np.asarray(one) for name, one in UNEVEN.items()}
    found = simulated()
    expected = posture(found["crank"], lengths, *offsets)
    np.testing.assert_allclose(found["x"], expected.tool[:, 0], rtol=1e-10)
    np.testing.assert_allclose(found["deviation"] + HEIGHT, expected.tool[:, 1], rtol=1e-10)
    np.testing.assert_allclose(found["transmission"], expected.transmission, rtol=1e-10)


def test_counts_find_the_published_linkage_within_its_published_error():
    nothing = dict.fromkeys(WIDTHS, 0.0)
    counts = count_linkages(LENGTHS, nothing, 10)
    assert counts.outside.count == 0
    # Half of 0.096 % of 400 mm above and below the line, and what rounding of its lengths moves it.
    assert counts.largest[0] == pytest.approx(0.00096 * 400 / 2, abs=0.15)


@pytest.fixture(scope="module")
def page():
    """The page of a quick run."""
    made = ext.Draft(load("four-bar", quick=True))
    made.fill()
    return made


@pytest.fixture(scope="module")
def counts(page):
    """The linkages of the published and of each design, counted by elimination."""
    decided = {name: one.decisions for name, one in page.kept["designs"].items()}
    sizes = {HOEKEN: (LENGTHS, WIDTHS)} | {
        name: ({part: one[f"{part}.nominal"] for part in LENGTHS}, {width: one[width] for width in WIDTHS})
        for name, one in decided.items()
    }
    found = {name: count_linkages(*one, 100_000) for name, one in sizes.items()}
    return {name: one.zone for name, one in found.items()}, {name: one.outside for name, one in found.items()}


@pytest.mark.slow
def test_the_mean_linkage_is_at_least_as_straight_as_the_published_one(page):
    """Its optimum has more freedoms, and its path touches the zone on both sides, as a best approximation does."""
    decided = page.kept["designs"][NOMINAL].decisions
    zone = float(decided["zone"])
    assert zone < 0.00096 * 400 / 2
    away = posture_of({name: decided[f"{name}.nominal"] for name in LENGTHS}, crank_angles(2001)).tool[:, 1] - HEIGHT
    # The expansion's mean includes a little of the curvature of the spread.
    assert [away.max(), away.min()] == pytest.approx([zone, -zone], rel=0.02)


@pytest.mark.slow
def test_the_designs_hold_on_fresh_linkages_which_elimination_counts_as_well(page, counts):
    designs, evidence, (zones, outside) = page.kept["designs"], page.kept["evidence"], counts
    for name in (NOMINAL, ROBUST, ALLOCATED):
        assert designs[name].ok, designs[name].why()
        assert evidence[name].agrees
    # The objective itself, sampled by elimination with the same random numbers: mean and spread at each place.
    assert zones[ROBUST] < zones[NOMINAL] < zones[HOEKEN]
    assert outside[ROBUST].estimate <= outside[NOMINAL].estimate < outside[HOEKEN].estimate
    assert evidence[ROBUST].joint.upper <= TARGET
    assert evidence[NOMINAL].violation("stroke", "transmission").lower > 0.5
    # The cheapest tolerances: at the margin the zone sampled by elimination is that of the program.
    assert outside[ALLOCATED].upper <= TARGET
    assert [float(designs[ALLOCATED].decisions["zone"]), zones[ALLOCATED]] == pytest.approx([ZONE] * 2, rel=0.01)
    simulated = evidence[ALLOCATED].violations["line"]
    assert simulated.lower <= outside[ALLOCATED].upper
    assert outside[ALLOCATED].lower <= simulated.upper
    assert designs[ALLOCATED].objective < designs[ROBUST].objective
