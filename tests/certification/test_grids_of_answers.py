"""Answers on grids that are too coarse for them."""

import numpy as np
import pytest

import aleator as al


class Runaway(al.System):
    """x' = 2 x + u, which no plan on coarse steps brings to rest."""

    states = ("x",)
    inputs = ("u",)

    def initial(self):
        return {"x": 1.0}

    def rhs(self, t, z, u):
        return (2 * z.x + u,)

    def outputs(self, t, z, u):
        return {"x": z.x, "effort": u**2}


@pytest.mark.parametrize("duration", [4.0, 8.0])
def test_a_limit_of_zero_is_as_large_as_what_it_limits_is_on_the_way_there(duration):
    u = al.Control(0.0, -50.0, 50.0, degree=1)
    problem = al.Problem(
        Runaway(),
        grid=al.Grid(duration, 40),
        inputs={"u": u},
        minimize=al.integral("effort").mean,
        subject_to=[al.terminal("x").mean.equals(0.0)],
    )
    solution = al.solve(problem, throw=False)
    finer = al.simulate(Runaway(), al.Grid(duration, 64 * 40), {"u": solution.signal("u")})
    assert abs(float(finer["x"][-1])) > 1e-2
    assert not solution.ok
    assert "on a finer grid 'x'" in solution.why()


class Settling(al.System):
    """What dies out, at an uncertain rate, beside what is designed."""

    states = ("x", "y")
    rate: al.Number
    d: al.Number

    def initial(self):
        return {"x": 1.0}

    def rhs(self, t, z):
        return -self.rate * z.x, self.d - z.y

    def outputs(self, t, z):
        return {"x": z.x, "y": z.y}


def test_a_limit_far_inside_its_bound_does_not_hang_on_what_its_expansion_misses():
    model = Settling(al.Uniform(4.0, half_width=2.5), al.Decision(0.5, 0.1, 3.0))
    residual, level = al.terminal("x"), al.terminal("y").mean <= 1.0
    limits = [residual.at_most(1.0, sigmas=2).named("residual"), level]
    problem = al.Problem(model, grid=al.Grid(8.0, 100), minimize=-al.value("d"), subject_to=limits)
    with pytest.warns(al.ExpansionWarning, match="does not resolve x"):
        solution = al.solve(problem, throw=False)
    assert solution.ok
    assert float(solution.decisions["d"]) == pytest.approx(1 / (1 - np.exp(-8.0)), rel=1e-6)


@pytest.mark.slow
def test_a_squared_distance_that_becomes_zero_is_no_error_of_the_grid():
    """States that are uncorrelated in the end, whose covariance has no size by which to judge it."""

    class Swing(al.System):
        states = ("x", "v")
        stiffness: al.Number
        damping: al.Number

        def initial(self):
            return {"x": 1.0}

        def rhs(self, t, z):
            return z.v, -self.stiffness * z.x - self.damping * z.v

        def outputs(self, t, z):
            return {"x": z.x, "v": z.v}

    numbers = al.Uniform(al.Decision(3.0, 0.1, 30.0), half_width=0.05), al.Uniform(al.Decision(0.5, 0.1, 9.0), std=0.02)
    objective = al.covariance(al.terminal("x"), al.terminal("v")) ** 2
    solution = al.solve(al.Problem(Swing(*numbers), grid=al.Grid(1.0, 160), minimize=objective))
    assert solution.objective < 1e-20
