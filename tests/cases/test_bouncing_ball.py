"""The bouncing ball of the Reference FMUs: state events, at an uncertain restitution.

Modelica Association, https://github.com/modelica/Reference-FMUs. The environment variable `REFERENCE_FMUS` names the
folder of an unpacked release. Right values are closed forms: `t1 = sqrt(2 / g)`, then flights of `2 e^n t1`.
"""

import os
from functools import partial
from pathlib import Path

import jax
import numpy as np
import pytest

import aleator as al

G = 9.81
FALL = np.sqrt(2 / G)


@pytest.fixture(params=["2.0", "3.0"])
def ball(request):
    """A function that opens the FMU, of either version."""
    pytest.importorskip("fmpy", reason="FMPy is not installed")
    if (folder := os.environ.get("REFERENCE_FMUS")) is None:
        pytest.skip("REFERENCE_FMUS does not name the folder of a release of the Reference FMUs")
    return partial(al.foreign.Fmu, Path(folder) / request.param / "BouncingBall.fmu", own_process=False)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "error"), [("model exchange", 1e-5), ("co-simulation", 5e-3)])
def test_an_uncertain_restitution_spreads_the_height(ball, kind, error):
    fall = al.foreign.FmuSimulation(ball(kind=kind), al.Grid(1.2, 12), outputs=["h"])

    def heights(numbers):
        """At 0.7 and 1.2 s, which no bounce comes near."""
        return fall(numbers)["h"][[7, 12]]

    assert heights({"e": 0.7}) == pytest.approx([0.4675918325, 0.1861218669], abs=error)
    found = al.expand(heights, {"e": al.Uniform(0.7, half_width=0.1)}, al.Expansion(order=4), traced=False)
    assert np.asarray(found.mean) == pytest.approx([0.4675918325, 0.1558396995], abs=error)
    assert np.asarray(found.std) == pytest.approx([0.0635439121, 0.0302186563], abs=error)


@pytest.mark.slow
def test_derivatives_across_a_bounce(ball):
    fall = al.foreign.FmuSimulation(ball(), al.Grid(0.7, 7), outputs=["h"])
    slope = jax.jacfwd(lambda e: fall({"e": e})["h"][-1])(0.7)
    assert slope == pytest.approx(np.sqrt(2 * G) * (0.7 - FALL), abs=1e-3)


@pytest.mark.slow
def test_the_ball_does_not_pass_through_the_floor(ball):
    instants = al.Grid(2 * FALL, 2)  # the bounce is at one of them
    assert al.foreign.FmuSimulation(ball(), instants, outputs=["h"])({})["h"][1] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
def test_equations_with_events_are_refused(ball):
    with pytest.raises(al.ProblemError, match="event indicator"):
        al.foreign.FmuSystem(ball())
