"""Limits over time on refined meshes, and answers to unstable systems, which no simulation from the start confirms."""

import numpy as np
import pytest
import scipy.integrate

import aleator as al


class Pushed(al.System):
    """`x' = growth x - stiffness x³ + u`."""

    states = ("x",)

    first: al.Number
    growth: al.Number
    stiffness: al.Number
    weight: al.Number

    def initial(self):
        return {"x": self.first}

    def rhs(self, t, z, u):
        return (self.growth * z.x - self.stiffness * z.x**3 + u,)

    def outputs(self, t, z, u):
        return {"x": z.x, "cost": z.x**2 + self.weight * u**2}


def above(least, system, grid, most, *more):
    control = al.Control(0.0, -most, most, degree=1)
    limits = [al.path("x").at_least(least), *more]
    return al.Problem(system, grid=grid, inputs={"u": control}, minimize=al.integral("cost").mean, subject_to=limits)


@pytest.mark.slow
def test_no_limit_is_evaded_between_the_points_of_a_finer_mesh():
    problem = above(1.0, Pushed(1.2, 0.0, 20.0, 1e-7), al.Grid(1.0, 20), 500.0)
    solution = al.solve(problem, transcription=al.Simultaneous(al.schemes.Radau(3), error=1e-3))
    (limit,), mesh, states = solution.constraints, solution.mesh, solution.mesh_states
    assert mesh is not None
    assert states is not None
    assert limit.times is not None
    # As x is 1 at least, so is the integral of its square, and to hold it there costs 4e-5.
    assert 1.0 < solution.objective < 1.01
    np.testing.assert_allclose(limit.times, states.times)
    assert mesh.intervals > 20
    assert len(limit.values) == len(limit.times) == 3 * mesh.intervals + 1
    (levels,) = solution.decisions.values()
    course = scipy.integrate.solve_ivp(
        lambda t, x: np.interp(t, mesh.nodes, levels) - 20 * x**3, (0.0, 1.0), [1.2], rtol=1e-9, max_step=1e-3
    )
    assert course.y.min() > 1.0 - 2e-3
    np.testing.assert_array_equal(al.reporting.dataset(solution)["times of limits"], limit.times)


@pytest.mark.slow
def test_a_plan_of_an_unstable_system_is_checked_from_its_own_states():
    end = al.terminal("x").mean.equals(1.0)
    problem = above(0.5, Pushed(1.0, 2.0, 0.0, 1e-3), al.Grid(20.0, 200), 50.0, end)
    solution = al.solve(problem, transcription=al.Simultaneous(al.schemes.Radau(3)))
    # Errors grow by e^40 on the way.
    assert "departs" in solution.certificate.departed
    assert "open loop" in str(solution.certificate)
    assert solution.mesh_states is not None
    assert solution.mesh_states["x"].min() == pytest.approx(0.5, abs=1e-3)
    # Held at 0.5 by a push of -1, for as long as 20 s but for the ends.
    assert solution.objective == pytest.approx(20 * (0.25 + 1e-3), rel=0.02)
