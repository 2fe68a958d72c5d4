"""Distributions, statistics, functionals, solvers of one's own are used like ours; contradictions are refused."""

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.special import ndtr

import aleator as al
from aleator import extending as ext
from zoo import Decay

arcsine = jax.jit(lambda normal: jnp.sin(jnp.pi * (ndtr(normal) - 0.5)))


class Arcsine(ext.AbstractDistribution):
    FORMS: ClassVar = {("center", "amplitude"): ext.Form(lambda center, amplitude: ext.Canonical(center, amplitude))}

    def __init__(self, center=None, amplitude=None, *, shared_name=None):
        self.set_parameters({"center": center, "amplitude": amplitude}, shared_name)

    def germ(self):
        return ext.JacobiGerm(0.5, 0.5)

    def from_normal(self, normal, shape):
        return arcsine(normal)

    def mean(self):
        return self.canonical().location

    def std(self):
        return self.canonical().scale / np.sqrt(2)

    def support(self):
        location, scale, _ = self.canonical()
        return location - scale, location + scale


class Spread(ext.AbstractStatistic):
    """The standard deviation once more."""

    symbol = "spread"

    def of(self, coefficients, constants):
        return jnp.sqrt(jnp.sum(coefficients[1:] ** 2, axis=0))

    def of_sample(self, values):
        return values.std(axis=0)


class Middle(ext.AbstractFunctional):
    """An output in the middle of the time."""

    def evaluate(self, taken, grid):
        values = taken.history[self.output]
        return values[len(values) // 2]

    def text(self):
        return f"{self.output} in the middle"


@dataclass(frozen=True)
class Claiming(ext.AbstractLocalSolver):
    """Says that the start is the solution, whatever it is."""

    @property
    def name(self):
        return "claims"

    def minimise(self, scaled, multipliers):
        return ext.Answer(al.Status.SOLVED, scaled.start, None, 1, "solved, I say")


def problem(minimize, rate=None, **more):
    distribution = al.Uniform(al.Decision(1.0, 0.5, 2.0), half_width=0.1)
    return al.Problem(Decay(distribution if rate is None else rate), grid=al.Grid(1.0, 20), minimize=minimize, **more)


def test_moments_of_a_distribution_of_ones_own_are_those_of_its_closed_form():
    expanded = al.expand(lambda at: jnp.stack([at["x"], at["x"] ** 2]), {"x": Arcsine(0.3, 0.2)})
    # The square of an arcsine variable a + b s has the variance 4 a² b² / 2 + b⁴ / 8.
    np.testing.assert_allclose(expanded.mean, [0.3, 0.3**2 + 0.2**2 / 2], rtol=1e-12)
    np.testing.assert_allclose(expanded.variance, [0.2**2 / 2, 2 * 0.3**2 * 0.2**2 + 0.2**4 / 8], rtol=1e-12)


def test_a_statistic_and_a_functional_of_ones_own_are_those_of_expansions_of_samples_and_of_evidence():
    distributions = {"u": al.Normal(1.0, 0.3)}
    expanded = al.expand(lambda at: at["u"] ** 2, distributions)
    assert float(expanded.statistic(Spread())) == pytest.approx(float(expanded.std), rel=1e-12)
    sample = al.references.monte_carlo(lambda at: at["u"] ** 2, distributions, 400, seed=0)
    assert sample.statistic(Spread()).value == pytest.approx(np.asarray(sample.values).std(), rel=1e-9)
    middle = Middle(("x",))
    found = al.solve(problem(middle.mean, subject_to=[middle.statistic(Spread()) <= 1.0]))
    # x(t) = exp(-rate t), the mean over rate ∈ [2 - 0.1, 2 + 0.1] at t = 0.5; of the square, that at t = 1.
    mean, square = ((np.exp(-1.9 * t) - np.exp(-2.1 * t)) / (0.2 * t) for t in (0.5, 1.0))
    assert found.objective == pytest.approx(mean, rel=1e-6)
    assert found.constraints[0].values[0] == pytest.approx(np.sqrt(square - mean**2), rel=1e-4)
    assert "μ[x in the middle]" in str(found)
    assert al.validate(found, 2000, seed=1).agrees


def test_what_a_solver_claims_is_not_believed():
    found = al.solve(problem(al.terminal("x").mean), Claiming(), throw=False)
    assert not found.ok
    assert found.certificate.stationarity > 1e-3


CONTRADICTIONS = {
    "germ": lambda self: ext.LegendreGerm(),
    "from_normal": lambda self, normal, shape: normal,
    "mean": lambda self: self.canonical().location + 5,
    "support": lambda self: (5.0, 6.0),
}


@pytest.mark.parametrize("name", CONTRADICTIONS)
def test_a_distribution_that_contradicts_itself_is_refused(name):
    wrong = type("Wrong", (Arcsine,), {name: CONTRADICTIONS[name], "__module__": __name__})
    with pytest.raises(al.ProblemError, match=r"Wrong: its germ and its .* contradict each other"):
        wrong(0.0, 1.0)
