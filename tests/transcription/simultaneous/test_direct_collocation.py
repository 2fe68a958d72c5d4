"""Problems solved by direct collocation: a known optimum, rules and ties."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.sparse.linalg import spsolve

import aleator as al
from aleator.transcription import transcribe
from zoo import Tank, block_problem


def test_an_uncertain_mass_spreads_the_end_by_its_own_spread():
    """What a mass moves is the mean of its inverse times what one kilogram does."""
    lower, upper = 0.5, 1.5
    force = al.BSpline(al.Decision(np.zeros(5), -50.0, 50.0), degree=3)
    mass = al.Uniform(1.0, half_width=0.5)
    problem = block_problem(mass, 20, inputs={"force": force}, expansion=al.Expansion(order=8))
    solution = al.solve(problem, transcription=al.Simultaneous())
    mean = np.log(upper / lower)
    assert solution.objective == pytest.approx(12.0 / mean**2, rel=1e-5)
    spread = np.sqrt(1 / (lower * upper) - mean**2) / mean
    assert solution.moments["x(t_f)"].std == pytest.approx(spread, rel=1e-4)
    # States are those of its realisations, each of which moves by the inverse of its mass.
    masses = 1.0 + 0.5 * solution.mesh_states.germs[:, 0]
    x = solution.mesh_states["x"]
    np.testing.assert_allclose(x * masses[:, None], np.broadcast_to(x[0] * masses[0], x.shape), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(solution.mesh_states.times[[0, -1]], [0.0, 1.0])


# --- Schemes ---------------------------------------------------------------------------------------------------------


SCHEMES = {
    "trapezoid": (al.schemes.Trapezoid(), 2),
    "Hermite and Simpson": (al.schemes.HermiteSimpson(), 4),
    "Radau 1": (al.schemes.Radau(1), 1),
    "Radau 2": (al.schemes.Radau(2), 3),
    "Radau 3": (al.schemes.Radau(3), 5),
    "Gauss 1": (al.schemes.GaussLegendre(1), 2),
    "Gauss 2": (al.schemes.GaussLegendre(2), 4),
    "Gauss 3": (al.schemes.GaussLegendre(3), 6),
}


@pytest.mark.parametrize(("scheme", "order"), SCHEMES.values(), ids=SCHEMES)
def test_the_quadrature_is_exact_up_to_the_order_and_rates_that_are_polynomials_are_integrated_exactly(scheme, order):
    assert scheme.order == order
    for degree in range(len(scheme.nodes)):
        exact = scheme.points[1:] ** (degree + 1) / (degree + 1)
        np.testing.assert_allclose(scheme.weights @ scheme.nodes**degree, exact, rtol=1e-13, atol=1e-14)
    for degree in range(order):
        assert scheme.weights[-1] @ scheme.nodes**degree == pytest.approx(1 / (degree + 1), rel=1e-13)
    # The next power is not integrated: the order is no higher than it says.
    assert abs(scheme.weights[-1] @ scheme.nodes**order - 1 / (order + 1)) > 1e-5


# --- Algebraic variables ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_ties_determine_the_hydrogen_of_the_exact_solution():
    """By Newton's method on the ties of a program: what they determine for given decisions."""
    problem = al.Problem(
        Tank(rate=al.Decision(5.0, 1.0, 9.0)),
        grid=al.Grid(2.0, 16),
        inputs={"feed": al.Tabulated(np.array([0.0, 2.0]), np.array([2.0, 0.2]))},
        minimize=al.terminal("hydrogen").mean,
    )
    transcribed = transcribe(problem, al.Simultaneous(al.schemes.Radau(2), guess=lambda t: {"acid": 0.4}))
    program, ties, point = transcribed.program, transcribed.assembled.rows.ties, transcribed.program.start.copy()
    for _ in range(12):
        found = program.evaluate(point)
        square = found.jacobian[ties.rows][:, ties.variables]
        step = spsolve(square.tocsc(), found.constraints[ties.rows])
        point[ties.variables] -= step
    assert np.abs(step).max() < 1e-13

    def h(acid):
        return 0.5 * (-0.1 + np.sqrt(0.01 + 0.4 * acid))

    def rate(t, acid):
        return 2.0 - 0.9 * t - 0.5 * acid - 5.0 * h(acid) * acid

    exact = solve_ivp(rate, (0.0, 2.0), [0.2], method="DOP853", rtol=1e-13, atol=1e-14).y[0, -1]
    assert transcribed.at(point).samples[0][0] == pytest.approx(h(exact), abs=1e-4)


class Pushed(al.System):
    """A block of uncertain mass with friction."""

    states = ("x", "v")
    mass: al.Number
    x_0: al.Number = 0.0

    def initial(self):
        return {"x": self.x_0, "v": 0.0}

    def rhs(self, t, z, force):
        return z.v, (force - 0.3 * z.v) / self.mass

    def outputs(self, t, z, force):
        return {"x": z.x, "v": z.v}


@pytest.mark.slow
@pytest.mark.parametrize("x_0", [0.0, al.Normal(0.0, 0.02)])
def test_a_spread_from_a_certain_start_on_has_no_kink_there(x_0):
    """At rest all realisations are alike, so that the derivative of σ has no value, whatever is decided."""
    problem = al.Problem(
        Pushed(al.Uniform(1.0, half_width=0.2), x_0),
        grid=al.Grid(al.Decision(3.0, 1.0, 10.0), 10),
        inputs={"force": al.Control(0.5, -2.0, 2.0, degree=1)},
        minimize=al.objectives.final_time() + 0.2 * al.time_integral(al.path("x").std),
        subject_to=[
            al.terminal("x").mean.equals(1.0),
            al.terminal("v").mean.equals(0.0),
            al.path("v").at_most(0.9, sigmas=1),
        ],
        expansion=al.Expansion(order=2),
    )
    collocated, shot = (al.solve(problem, transcription=one, between=1) for one in (al.Simultaneous(), al.Sequential()))
    assert collocated.objective == pytest.approx(shot.objective, rel=1e-5)


class Relaxing(al.System):
    """Van der Pol's oscillator, stiff."""

    states = ("x", "v")
    mu: al.Number

    def initial(self):
        return {"x": 2.0}

    def rhs(self, t, z):
        return z.v, self.mu * (1 - z.x**2) * z.v - z.x

    def outputs(self, t, z):
        return {"x": z.x}


@pytest.mark.slow
def test_nothing_is_sought_beside_an_objective_at_its_least():
    """States far from any motion of a stiff system lead to ever larger ones: the search went on for minutes."""
    target, half_width = 1.4, 1.0
    problem = al.Problem(
        Relaxing(al.Uniform(al.Decision(50.0, 20.0, 100.0), half_width=half_width)),
        grid=al.Grid(30.0, 40),
        minimize=(al.terminal("x").mean - target) ** 2,
        integrator=al.integrators.Rodas5P(),
    )
    solution = al.solve(problem, transcription=al.Simultaneous(al.schemes.Radau(3)))
    assert solution.effort.evaluations < 30

    def end(mu):
        return solve_ivp(
            lambda t, z: (z[1], mu * (1 - z[0] ** 2) * z[1] - z[0]),
            (0.0, 30.0),
            (2.0, 0.0),
            method="Radau",
            rtol=1e-9,
            atol=1e-11,
        ).y[0, -1]

    nodes, weights = np.polynomial.legendre.leggauss(5)
    mean = weights @ [end(solution.decisions["mu.mean"] + half_width * node) for node in nodes] / 2
    assert mean == pytest.approx(target, abs=1e-5)
