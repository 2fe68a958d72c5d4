"""Every statistic as part of a problem: its value, its derivatives, what it compiles, and designs that it shapes."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import aleator as al
from aleator.transcription import transcribe
from zoo import HALF_WIDTH, LOSS, ONE_STEP, RESPONSE, Gain, algebraic, derivative_error, optimum

GAIN = 1.7
THETA = stats.uniform(1.0 - HALF_WIDTH, 2 * HALF_WIDTH)


def with_limits(*limits, theta=None, shift=0.0):
    theta = al.Uniform(1.0, half_width=HALF_WIDTH) if theta is None else theta
    return al.Problem(
        Gain(al.Decision(0.5, 0.0, 10.0), theta, shift), grid=ONE_STEP, minimize=LOSS.mean, subject_to=limits
    )


CLOSED = [  # of a linear response: the statistic, its value, the tolerance
    (RESPONSE.variance, GAIN**2 * THETA.var(), 1e-12),
    (RESPONSE.supremum, GAIN * THETA.ppf(1), 1e-9),
    (RESPONSE.infimum, GAIN * THETA.ppf(0), 1e-9),
    (RESPONSE.quantile(0.9), GAIN * THETA.ppf(0.9), 5e-3),
    (RESPONSE.quantile(0.05), GAIN * THETA.ppf(0.05), 5e-3),
    (RESPONSE.conditional_value_at_risk(0.9), GAIN * THETA.ppf(0.95), 5e-3),
    (RESPONSE.probability(above=1.9), THETA.sf(1.9 / GAIN), 2e-2),
    (RESPONSE.probability(below=1.9), THETA.cdf(1.9 / GAIN), 2e-2),
    (RESPONSE.skewness, 0.0, 1e-9),
    (RESPONSE.kurtosis, 1.8, 1e-9),
    (RESPONSE.sobol("theta"), 1.0, 1e-12),
    (RESPONSE.total_sobol("theta"), 1.0, 1e-12),
    (al.covariance(RESPONSE, LOSS), 0.0, 1e-12),
    (al.covariance(RESPONSE, RESPONSE), GAIN**2 * THETA.var(), 1e-12),
    (al.correlation(RESPONSE, RESPONSE), 1.0, 1e-12),
]


@pytest.mark.parametrize("closed", [CLOSED[3::4], pytest.param(CLOSED, marks=pytest.mark.slow)], ids=["some", "every"])
def test_every_statistic_of_a_linear_response_is_its_closed_form(closed):
    limits = [(one <= 1.0).named(f"limit {i}") for i, (one, _, _) in enumerate(closed)]
    found = transcribe(with_limits(*limits)).program.evaluate(np.array([GAIN])).constraints
    for value, (one, expected, tolerance) in zip(found, closed, strict=True):
        assert value == pytest.approx(expected, rel=tolerance, abs=tolerance), str(one)


def test_sobol_indices_of_a_sum_share_its_variance():
    indices = RESPONSE.sobol("theta"), RESPONSE.total_sobol("shift"), RESPONSE.sobol("theta", "shift")
    limits = [(one <= 1.0).named(f"limit {i}") for i, one in enumerate(indices)]
    problem = with_limits(*limits, shift=al.Normal(0.0, 0.2))
    first, second = 4 * 0.3**2 / 3, 0.2**2
    found = transcribe(problem).program.evaluate(np.array([2.0])).constraints
    assert found == pytest.approx([first / (first + second), second / (first + second), 0.0], abs=1e-12)


class Kick(al.System):
    """`x = a theta + theta² + shift`, no dynamics; a vector and a product beside it."""

    states = ("nothing",)
    a: al.Number
    theta: al.Number
    shift: al.Number

    def rhs(self, t, z):
        return (0.0 * z.nothing,)

    def outputs(self, t, z):
        x = self.a * self.theta + self.theta**2 + self.shift
        return {"x": x, "y": x * self.shift + self.a * t, "pair": jnp.stack([x, self.shift])}


X, PATH = al.terminal("x"), al.path("y")
EVERY = [
    X.skewness,
    X.kurtosis,
    X.supremum,
    X.quantile(0.9),
    X.cornish_fisher(0.9),
    X.probability(above=1.2),
    X.conditional_value_at_risk(0.9),
    X.sobol("theta"),
    X.total_sobol("shift"),
    PATH.supremum,
    PATH.quantile(0.2),
    PATH.skewness,
    al.terminal("pair").quantile(0.7),
    al.covariance(X, al.terminal("y")),
    al.correlation(PATH, al.path("x")),
]


@pytest.mark.parametrize("statistics", [EVERY[::5], pytest.param(EVERY, marks=pytest.mark.slow)], ids=["some", "every"])
def test_derivatives_of_every_statistic_agree_with_central_differences(statistics):
    kick = Kick(
        al.Decision(0.4, 0.1, 2.0),
        al.Uniform(al.Decision(0.5, 0.1, 2.0), half_width=0.5),
        al.Uniform(0.1, half_width=0.3),
    )
    limits = [(one <= 1.0).named(f"limit {i}") for i, one in enumerate(statistics)]
    transcribed = transcribe(al.Problem(kick, grid=al.Grid(1.0, 3), minimize=X.mean, subject_to=limits))
    program, point = transcribed.program, np.array([0.43, 0.57])
    exact = program.evaluate(point)
    assert np.isfinite(exact.jacobian).all()

    def values(x):
        return program.evaluate(x).constraints

    steps = (1e-4, 1e-5, 1e-6)
    assert derivative_error(values, exact.jacobian, point, transcribed.rows, steps) < 1e-5


def test_a_deterministic_problem_knows_every_statistic():
    limits = [
        RESPONSE.at_most(2.0, probability=0.99),
        RESPONSE.at_most(2.5, worst_case=True).named("sure"),
        (RESPONSE.sobol("theta") <= 1.0).named("share"),
        (RESPONSE.skewness <= 1.0).named("skew"),
        (al.correlation(RESPONSE, LOSS) <= 1.0).named("together"),
    ]
    nominal = optimum(al.deterministic(with_limits(*limits)))
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
Vanishing = algebraic(lambda k, d: {"cost": (k - 1.0) ** 2 + d**2, "product": k * d})


@pytest.mark.parametrize("which", ["cost", "product"])
@pytest.mark.parametrize("family", [al.Normal, lambda mean, spread: al.Uniform(mean, half_width=spread)])
def test_a_spread_that_vanishes_at_the_optimum_is_no_reason_to_refuse_it(family, which):
    uncertain = family(al.Decision(2.0, 0.0, 5.0), al.Decision(0.5, 0.0, 2.0))
    model = Vanishing(uncertain, al.Decision(1.0, 0.1, 5.0))
    solution = al.solve(al.Problem(model, minimize=al.output("cost").mean + al.output(which).std))
    assert solution.objective == pytest.approx(0.01, rel=1e-9)
    assert solution.decisions["d"] == pytest.approx(0.1, rel=1e-9)
