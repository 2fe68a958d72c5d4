"""Every statistic as part of a problem: its value, its derivatives, what it compiles, and designs that it shapes."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import aleator as al
from aleator.transcription import transcribe
from zoo import LOSS, ONE_STEP, RESPONSE, algebraic, derivative_error, gain_problem, optimum


class Kick(al.System):
    """`x = a theta + shift + bend (theta² + theta shift)`, no dynamics; a vector and a product beside it."""

    states = ("nothing",)
    a: al.Number
    theta: al.Number
    shift: al.Number
    bend: al.Number

    def rhs(self, t, z):
        return (0.0 * z.nothing,)

    def outputs(self, t, z):
        x = self.a * self.theta + self.shift + self.bend * self.theta * (self.theta + self.shift)
        return {"x": x, "y": x * self.shift + self.a * t, "pair": jnp.stack([x, self.shift])}


A, MEAN, HALF = 1.7, 1.0, 0.3
THETA, X, PATH = stats.uniform(MEAN - HALF, 2 * HALF), al.terminal("x"), al.path("y")
CLOSED = [  # of `a theta` alone: the statistic, its value, the tolerance
    (X.quantile(0.9), A * THETA.ppf(0.9), 5e-3),
    (X.probability(below=1.9), THETA.cdf(1.9 / A), 2e-2),
    (X.sobol("theta"), 1.0, 1e-12),
    (X.skewness, 0.0, 1e-9),
    (X.quantile(0.05), A * THETA.ppf(0.05), 5e-3),
    (X.variance, A**2 * THETA.var(), 1e-12),
    (X.supremum, A * THETA.ppf(1), 1e-9),
    (X.infimum, A * THETA.ppf(0), 1e-9),
    (X.conditional_value_at_risk(0.9), A * THETA.ppf(0.95), 5e-3),
    (X.probability(above=1.9), THETA.sf(1.9 / A), 2e-2),
    (X.kurtosis, 1.8, 1e-9),
    (X.total_sobol("theta"), 1.0, 1e-12),
    (al.covariance(X, al.terminal("y")), 0.0, 1e-12),
    (al.covariance(X, X), A**2 * THETA.var(), 1e-12),
    (al.correlation(X, X), 1.0, 1e-12),
]
FURTHER = [
    PATH.quantile(0.2),
    X.total_sobol("shift"),
    X.sobol("theta", "shift"),
    X.cornish_fisher(0.9),
    PATH.supremum,
    PATH.skewness,
    al.terminal("pair").quantile(0.7),
    al.correlation(PATH, al.path("x")),
]
SOME, EVERY = (4, 3), (len(CLOSED), len(FURTHER))
each_table = pytest.mark.parametrize(
    ("closed", "further"), [SOME, pytest.param(*EVERY, marks=pytest.mark.slow)], ids=["some", "every"]
)


def with_limits(closed, further, bend, shift):
    """The program of a problem with some of the statistics as limits, and where its constraints stand."""
    every = [one for one, _, _ in CLOSED[:closed]] + FURTHER[:further]
    theta = al.Uniform(al.Decision(0.5, 0.1, 2.0), half_width=HALF)
    kick = Kick(al.Decision(0.4, 0.1, 2.0), theta, al.Uniform(0.1 * bend, half_width=shift), bend)
    limits = [(one <= 1.0).named(f"limit {i}") for i, one in enumerate(every)]
    found = transcribe(al.Problem(kick, grid=al.Grid(1.0, 3), minimize=X.mean, subject_to=limits))
    return found.program, found.rows


@each_table
def test_every_statistic_of_a_linear_response_is_its_closed_form(closed, further):
    program, rows = with_limits(closed, further, bend=0.0, shift=1e-13)
    values = program.evaluate(np.array([A, MEAN])).constraints
    for row, (one, expected, tolerance) in zip(rows, CLOSED[:closed], strict=False):
        assert values[row] == pytest.approx(expected, rel=tolerance, abs=tolerance), str(one)


def test_sobol_indices_of_a_sum_share_its_variance():
    program, rows = with_limits(*SOME, bend=0.0, shift=0.2)
    first, second = 4 * HALF**2 / 3, 0.2**2 / 3
    values = program.evaluate(np.array([2.0, MEAN])).constraints
    shares = np.array([values[rows[i]].item() for i in (2, 5, 6)])
    assert shares == pytest.approx([first / (first + second), second / (first + second), 0.0], abs=1e-12)


@each_table
def test_derivatives_of_every_statistic_agree_with_central_differences(closed, further):
    program, rows = with_limits(closed, further, bend=1.0, shift=0.3)
    point = np.array([0.87, 1.03])
    exact = program.evaluate(point)
    assert np.isfinite(exact.jacobian).all()

    def values(x):
        return program.evaluate(x).constraints

    assert derivative_error(values, exact.jacobian, point, rows, steps=(1e-5,)) < 1e-5


def test_a_deterministic_problem_knows_every_statistic():
    limits = [
        RESPONSE.at_most(2.0, probability=0.99),
        RESPONSE.at_most(2.5, worst_case=True).named("sure"),
        (RESPONSE.sobol("theta") <= 1.0).named("share"),
        (RESPONSE.skewness <= 1.0).named("skew"),
        (al.correlation(RESPONSE, LOSS) <= 1.0).named("together"),
    ]
    problem = al.Problem(gain_problem().system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=limits)
    nominal = optimum(al.deterministic(problem))
    assert nominal.decisions["gain"] == pytest.approx(2.0, rel=1e-6)
    statistics = nominal.transcribed.statistics(nominal.outcome.point)
    assert statistics["Q0.99[response(t_f)]"] == pytest.approx(2.0, rel=1e-6)


def test_a_failed_system_leaves_a_design_without_any_value():
    root = algebraic(lambda size, off: {"root": jnp.sqrt(size + off), "size": size})
    model = root(al.Decision(2.0, 0.1, 5.0), al.Uniform(0.0, half_width=1.0))
    likely = al.output("root").probability(above=3.0) <= 0.1
    program = transcribe(al.Problem(model, minimize=al.output("size").mean, subject_to=[likely])).program
    for size, is_finite in ((2.0, True), (0.5, False)):
        found = program.evaluate(np.array([size]))
        assert np.isfinite(np.append(found.constraints, found.objective)).all() == is_finite
        assert np.isnan(found.objective) != is_finite


# A cost that is least at k = 1, and a product whose spread vanishes with that of k.
@algebraic
def vanishing(k, d, share):
    cost = (k - 1.0) ** 2 + d**2
    return {"cost": cost, "either": share * cost + (1 - share) * k * d}


@pytest.mark.parametrize("share", [1.0, 0.0], ids=["cost", "product"])
def test_a_spread_that_vanishes_at_the_optimum_is_no_reason_to_refuse_it(share):
    uncertain = al.Normal(al.Decision(2.0, 0.0, 5.0), al.Decision(0.5, 0.0, 2.0))
    model = vanishing(uncertain, al.Decision(1.0, 0.1, 5.0), share)
    solution = al.solve(al.Problem(model, minimize=al.output("cost").mean + al.output("either").std))
    assert solution.objective == pytest.approx(0.01, rel=1e-9)
    assert solution.decisions["d"] == pytest.approx(0.1, rel=1e-9)
