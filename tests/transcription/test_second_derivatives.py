"""Exact second derivatives of sequential programs: against differences of gradients, and what they are good for."""

import numpy as np
import pytest

import aleator as al
from aleator.transcription import transcribe
from tiny_models import oscillator_problem

EXACT = al.Sequential(second_derivatives=True)


class Cart(al.System):
    """A mass that is pushed; the objective is linear in the push, so that an arc of it is singular."""

    states = ("x", "v")
    mass: al.Number

    def initial(self):
        return {"x": 0.0, "v": 1.0}

    def rhs(self, t, z, force):
        return z.v, force / self.mass

    def outputs(self, t, z, force):
        return {"loss": 0.5 * (z.x**2 + z.v**2), "x": z.x}


LOSS = al.integral("loss").mean


def singular(points=21, *limits, minimize=LOSS):
    push = al.Tabulated(np.linspace(0.0, 5.0, points), al.Decision(np.zeros(points), -1.0, 1.0))
    return al.Problem(
        Cart(al.Uniform(1.0, half_width=0.1)),
        grid=al.Grid(5.0, 100),
        inputs={"force": push},
        minimize=minimize,
        subject_to=limits,
        expansion=al.Expansion(order=3),
    )


PROBLEMS = {
    "path, spread and integral": singular(4, al.path("x").at_most(0.5, sigmas=2.0), al.terminal("x").mean ** 2 <= 0.04),
    "quantile and product": singular(
        3, al.rms("x").quantile(0.9) <= 0.4, minimize=al.rms("x").std * al.integral("loss").mean
    ),
    "decided distribution": oscillator_problem(),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_they_are_the_slopes_of_the_lagrangians_gradient(name):
    program = transcribe(PROBLEMS[name], EXACT).program
    assert program.hessian is not None
    generator = np.random.default_rng(3)
    x = program.start + 0.05 * generator.uniform(0.2, 1.0, program.start.size)
    multipliers, weight = generator.uniform(-1.0, 1.0, program.constraint_lower.size), 0.7

    def gradient(point):
        found = program.evaluate(point)
        return weight * found.gradient + multipliers @ found.jacobian

    step = 1e-5
    slopes = [(gradient(x + step * one) - gradient(x - step * one)) / (2 * step) for one in np.eye(x.size)]
    found = program.hessian.evaluate(x, weight, multipliers).toarray()
    size = np.abs(slopes).max()
    np.testing.assert_allclose(found, np.tril(slopes), atol=2e-6 * size)


def test_a_singular_arc_takes_a_few_steps_instead_of_dozens():
    problem = singular()
    known, exact = (al.solve(problem, transcription=way, between=1) for way in (al.Sequential(), EXACT))
    assert exact.objective == pytest.approx(known.objective, rel=1e-9)
    np.testing.assert_allclose(exact.vector, known.vector, atol=1e-3)
    assert 4 * exact.effort.iterations < known.effort.iterations


def test_limits_on_the_worst_case_keep_them():
    problem = singular(4, al.path("x").at_most(0.55, worst_case=True))
    known, exact = (al.solve(problem, transcription=way, between=1) for way in (al.Sequential(), EXACT))
    assert exact.objective == pytest.approx(known.objective, rel=1e-6)


def test_only_true_or_false():
    with pytest.raises(al.ProblemError, match="second_derivatives"):
        al.Sequential(second_derivatives="yes")  # type: ignore[arg-type]
