"""Controls that neither bound holds: the turnpike, and two catalysts that are mixed along a reactor.

COPS 3.0, problem 14 ("catmix"); Jackson (1968) for the long reactor; OptimalControl.jl for the turnpike.
"""

import numpy as np
import pytest

import aleator as al


class Turnpike(al.System):
    """From 1 to 1/2 in 2 s along zero."""

    states = ("x",)

    first: al.Number

    def initial(self):
        return {"x": self.first}

    def rhs(self, t, z, u):
        return (u,)

    def outputs(self, t, z, u):
        return {"x": z.x, "square": z.x**2}


@pytest.mark.slow
@pytest.mark.parametrize("way", [al.Sequential(second_derivatives=True), al.Simultaneous()], ids=["shot", "collocated"])
def test_the_turnpike_runs_along_zero(way):
    problem = al.Problem(
        Turnpike(al.Uniform.bounds(0.9, 1.1)),
        grid=al.Grid(2.0, 40),
        inputs={"u": al.Control(0.0, -1.0, 1.0)},
        minimize=al.integral("square").mean,
        subject_to=[al.terminal("x").mean.equals(0.5)],
    )
    solution = al.solve(problem, transcription=way)
    assert solution.objective == pytest.approx(3 / 8 + 2 * 0.2**2 / 12, abs=1e-4)
    control = np.repeat([-1.0, 0.0, 1.0], [20, 10, 10])
    assert solution.decisions["inputs.u"] == pytest.approx(control, abs=0.02)
    if solution.costates is not None:
        assert abs(solution.costates["x"][:, 0].sum()) == pytest.approx(1.0, abs=1e-3)


class Reactor(al.System):
    states = ("x1", "x2")

    def initial(self):
        return {"x1": 1.0}

    def rhs(self, t, z, u):
        forth = u * (10 * z.x2 - z.x1)
        return forth, -forth - (1 - u) * z.x2

    def outputs(self, t, z, u):
        return {"product": z.x1 + z.x2 - 1}


@pytest.mark.slow
def test_catalysts_are_mixed():
    problem = al.Problem(
        Reactor(),
        grid=al.Grid(4.0, 60),
        inputs={"u": al.Control(0.5, 0.0, 1.0)},
        minimize=al.terminal("product").mean,
    )
    solution = al.solve(problem, transcription=al.Simultaneous(al.schemes.Radau(3)))
    assert solution.objective == pytest.approx(-0.1918141, abs=1e-5)
