"""Algebraic variables as variables of a simultaneous program: the other transcription's answer, and their order."""

import numpy as np
import pytest
from collocated_problems import fed, robustly_fed
from scipy.integrate import solve_ivp
from scipy.sparse.linalg import spsolve

import aleator as al
from aleator.transcription import transcribe
from stirred_tanks import ExplicitTank
from zoo import Tank, optimum


@pytest.mark.slow
def test_both_transcriptions_give_the_same_robust_feed():
    usual, other = (optimum(robustly_fed(50), transcription=one) for one in (al.Sequential(), al.Simultaneous()))
    assert other.objective == pytest.approx(usual.objective, rel=1e-6)
    np.testing.assert_allclose(other.decisions["inputs.feed.free"], usual.decisions["inputs.feed.free"], rtol=1e-3)
    # Both limits bind, so that the design is one for the whole family.
    rows = usual.transcribed.rows
    assert all(np.abs(usual.outcome.multipliers[one]).max() > 1e-3 for one in rows)


SCHEMES = {"Radau": (al.schemes.Radau(2), 3), "Hermite and Simpson": (al.schemes.HermiteSimpson(), 4)}


def _tied(scheme, intervals):
    """The hydrogen at the end, by Newton's method on the ties of a program: what they determine for given decisions."""
    problem = al.Problem(
        Tank(rate=al.Decision(5.0, 1.0, 9.0)),
        grid=al.Grid(2.0, intervals),
        inputs={"feed": al.PowerSeries(start=2.0, end=0.2)},
        minimize=al.terminal("hydrogen").mean,
    )
    transcribed = transcribe(problem, al.Simultaneous(scheme, guess=lambda t: {"acid": 0.4}))
    program, point = transcribed.program, transcribed.program.start.copy()
    for _ in range(12):
        found = program.evaluate(point)
        square = found.jacobian[program.ties.rows][:, program.ties.variables]
        step = spsolve(square.tocsc(), found.constraints[program.ties.rows])
        point[program.ties.variables] -= step
    assert np.abs(step).max() < 1e-13
    return float(transcribed.at(point).samples[0][0])


@pytest.mark.parametrize(
    ("name", "counts"), [("Radau", [16]), *(pytest.param(one, [16, 32], marks=pytest.mark.slow) for one in SCHEMES)]
)
def test_schemes_keep_their_order(name, counts):
    scheme, order = SCHEMES[name]

    def h(acid):
        return 0.5 * (-0.1 + np.sqrt(0.01 + 0.4 * acid))

    def rate(t, acid):
        return 2.0 - 0.9 * t - 0.5 * acid - 5.0 * h(acid) * acid

    exact = solve_ivp(rate, (0.0, 2.0), [0.2], method="DOP853", rtol=1e-13, atol=1e-14).y[0, -1]
    errors = [abs(_tied(scheme, count) - h(exact)) for count in counts]
    assert errors[0] < 1e-4
    if len(errors) > 1:
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.35)


@pytest.mark.slow
def test_costates_and_switching_functions_are_those_of_the_eliminated_equations_and_segments_solve_them_on_the_way():
    way = al.Simultaneous(al.schemes.Radau(2))
    one, other = (optimum(fed(tank), transcription=way) for tank in (Tank(), ExplicitTank()))
    (costates, switching), (expected, switches) = (
        each.transcribed.costates_at(each.outcome.point, each.outcome.multipliers) for each in (one, other)
    )
    np.testing.assert_allclose(costates["acid"], expected["acid"], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(switching["feed"], switches["feed"], rtol=1e-5, atol=1e-8)
    segments = al.Simultaneous(al.schemes.MultipleShooting(1))
    shot, usual = (optimum(fed(), transcription=way) for way in (segments, al.Sequential()))
    assert shot.objective == pytest.approx(usual.objective, rel=1e-8)
