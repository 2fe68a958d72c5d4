"""Answers on grids that are too coarse for them."""

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
