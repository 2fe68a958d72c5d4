"""Algebraic variables as variables of a simultaneous program: the other transcription's answer, and their order."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.sparse.linalg import spsolve

import aleator as al
from aleator.transcription import transcribe
from stirred_tanks import ExplicitTank, Tank, hydrogen, tank_problem


@pytest.mark.slow
def test_both_transcriptions_give_the_same_robust_feed():
    usual, other = (
        al.solve(tank_problem(), transcription=one, accuracy=2e-2) for one in (al.Sequential(), al.Simultaneous())
    )
    assert usual.ok
    assert other.ok
    assert other.objective == pytest.approx(usual.objective, rel=1e-6)
    np.testing.assert_allclose(other.vector, usual.vector, rtol=1e-4, atol=1e-5)
    # Both limits bind, so that the design is one for the whole family.
    assert all(np.abs(one.multipliers).max() > 1e-3 for one in usual.constraints)


SCHEMES = {
    "Hermite and Simpson": (al.schemes.HermiteSimpson(), 4),
    "Radau 2": (al.schemes.Radau(2), 3),
    "Gauss 2": (al.schemes.GaussLegendre(2), 4),
}


def _tied(scheme, intervals):
    """The hydrogen at the end, by Newton's method on the ties of a program: what they determine for given decisions."""
    problem = al.Problem(
        Tank(rate=al.Decision(5.0, 1.0, 9.0)),
        grid=al.Grid(2.0, intervals),
        inputs={"feed": al.PowerSeries(start=2.0, end=0.2)},
        minimize=al.terminal("hydrogen").mean,
    )
    transcribed = transcribe(problem, al.Simultaneous(scheme))
    program, point = transcribed.program, transcribed.program.start.copy()
    for _ in range(8):
        found = program.evaluate(point)
        square = found.jacobian[program.ties.rows][:, program.ties.variables]
        step = spsolve(square.tocsc(), found.constraints[program.ties.rows])
        point[program.ties.variables] -= step
    assert np.abs(step).max() < 1e-13
    return float(transcribed.at(point).samples[0][0])


@pytest.mark.slow
@pytest.mark.parametrize("name", SCHEMES)
def test_schemes_keep_their_order(name):
    scheme, order = SCHEMES[name]

    def rate(t, acid):
        return np.asarray(Tank(rate=5.0).change(acid, hydrogen(0.1, acid), 2.0 - 0.9 * t)[0])

    exact = solve_ivp(rate, (0.0, 2.0), [0.2], method="DOP853", rtol=1e-13, atol=1e-14).y[0, -1]
    first, second = (abs(_tied(scheme, count) - float(hydrogen(0.1, exact))) for count in (16, 32))
    assert np.log2(first / second) == pytest.approx(order, abs=0.35)


@pytest.mark.slow
def test_costates_and_switching_functions_are_those_of_the_eliminated_equations():
    found = []
    for tank in (Tank(), ExplicitTank()):
        problem = al.Problem(
            tank,
            grid=al.Grid(2.0, 6),
            inputs={"feed": al.BSpline(al.Decision(np.full(4, 0.5), 0.0, 5.0), degree=2)},
            minimize=al.integral("miss").mean,
        )
        found.append(al.solve(problem, transcription=al.Simultaneous(al.schemes.Radau(2)), between=1, throw=False))
    one, other = found
    np.testing.assert_allclose(one.costates["acid"], other.costates["acid"], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(one.switching["feed"], other.switching["feed"], rtol=1e-5, atol=1e-8)
