"""An arm whose torques are linear in an uncertain payload: their spread has a kink wherever it passes zero.

The plan of section 5.5.2 of the dissertation without its obstacle, beside SciPy's on the same 90 steps, and on more.
There a limit on `μ ± σ` is four linear ones in the payload's slope, without any kink.
"""

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.optimize import minimize

import aleator as al
from aleator.studies.pick_and_place_time import FREE, INSTANTS, PAYLOAD, robust_problem
from aleator.studies.two_link_arm import START, TARGET, TORQUE, TwoLinkArm, bent_path

KNOTS = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, FREE + 2), np.ones(3)])


def torques(angles, rates, accelerations, payload):
    """Of two rods of 1 kg and 1 m with a payload at the tip, by the dissertation's matrices."""
    inner, outer = 1 / 3 + 1 + payload, 1 / 3 + payload
    coupling = (0.5 + payload) * np.cos(angles[:, 1])
    h = (0.5 + payload) * np.sin(angles[:, 1])
    (v, w), (a, b) = rates.T, accelerations.T
    first = (inner + outer + 2 * coupling) * a + (outer + coupling) * b - h * w * (2 * v + w)
    return np.stack([first, (outer + coupling) * a + outer * b + h * v**2])


def fastest(points, steps):
    """The least time with limits at the ends of so many steps, by SciPy."""
    places = np.linspace(0.0, 1.0, steps + 1)
    splines = [BSpline(KNOTS, row, 3) for row in np.eye(FREE + 4)]
    bases = [np.stack([(one.derivative(k) if k else one)(places) for one in splines], axis=1) for k in range(3)]

    def slacks(x):
        ends = np.tile(START, (2, 1)), np.tile(TARGET, (2, 1))
        control = np.concatenate([ends[0], x[:-1].reshape(FREE, 2), ends[1]])
        angles, rates, accelerations = (basis @ control / x[-1] ** k for k, basis in enumerate(bases))
        mean, empty = (torques(angles, rates, accelerations, payload) for payload in (1.0, 0.0))
        spread = 0.5 * (mean - empty)
        held = [TORQUE - side * mean - other * spread for side in (1, -1) for other in (1, -1)]
        elbow = np.cos(angles[:, 0])
        return np.concatenate([*map(np.ravel, held), elbow, elbow + np.cos(angles.sum(axis=1))])

    def slopes(x):
        return np.stack([slacks(x + 1e-30j * step).imag for step in np.eye(x.size)], axis=1) / 1e-30

    found = minimize(
        lambda x: x[-1],
        np.append(points, 2.0),
        jac=lambda x: np.eye(x.size)[-1],
        bounds=[(-3.0, 3.0)] * points.size + [(0.5, 6.0)],
        constraints={"type": "ineq", "fun": slacks, "jac": slopes},
        method="SLSQP",
        options={"maxiter": 1000, "ftol": 1e-13},
    )
    assert found.success
    return found.fun


@pytest.mark.slow
def test_the_fastest_plan_at_kinks_of_spreads_is_that_of_scipy_without_kinks():
    ends = {"start": (START, 0), "end": (TARGET, 0)}
    points = al.fit_control_points(bent_path(), FREE, **ends)
    declared = robust_problem()
    problem = al.Problem(
        al.InverseDynamics(TwoLinkArm(payload=PAYLOAD), motion=al.BSpline(al.Decision(points, -3.0, 3.0), **ends)),
        grid=declared.grid,
        minimize=declared.objective,
        subject_to=[one for one in declared.constraints if one.name != "obstacle"],
        expansion=declared.expansion,
    )
    at_instants = al.solve(problem, between=1)
    assert at_instants.objective == pytest.approx(1.5809265, abs=1e-6)
    assert at_instants.objective == pytest.approx(fastest(points, INSTANTS), rel=1e-8)
    held, lowest = al.solve(problem), fastest(points, 5 * INSTANTS)
    assert lowest * (1 - 1e-6) <= held.objective <= lowest * (1 + 1e-3)
