"""Limits on quantiles, probabilities and means beyond quantiles, against closed forms: the optimum, or not ok."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from scipy import stats

import aleator as al
from zoo import algebraic, cases

U = stats.norm.ppf
# Responses of two normal numbers, with the quantile of each at a level: which, is data of the model.
RESPONSES = {
    "exponential": (lambda u, v: jnp.exp(0.3 * u), lambda p: np.exp(0.3 * U(p))),
    "reciprocal": (lambda u, v: 1 / (1 + 0.12 * u), lambda p: 1 / (1 - 0.12 * U(p))),
    "square of a reciprocal": (lambda u, v: 1 / (1 + 0.1 * u) ** 2, lambda p: 1 / (1 - 0.1 * U(p)) ** 2),
    "squares": (lambda u, v: u**2 + v**2, lambda p: -2 * np.log(1 - p)),
    # Bessel's K0 is the density of a product: the distribution function by SciPy's quadrature, inverted.
    "product": (lambda u, v: 4 + u * v, {0.9999: 11.2278}.get),
}


@algebraic
def rod(d, u, v, weights):
    """A size `d` times a response that is limited."""
    each = zip(weights, RESPONSES.values(), strict=True)
    return {"y": d * sum(weight * response(u, v) for weight, (response, _) in each), "d": d}


def largest(response, limit, order, *, least=False):
    """The largest, or the least, size whose response keeps a limit."""
    weights = [float(response == one) for one in RESPONSES]
    model = rod(al.Decision(2.0, 0.01, 50.0), al.Normal(0.0, 1.0), al.Normal(0.0, 1.0), weights)
    objective = (1 if least else -1) * al.output("d").mean
    problem = al.Problem(model, minimize=objective, subject_to=[limit], expansion=al.Expansion(order=order))
    return al.solve(problem, throw=False)


LEVEL = 0.9999
SLOW = [(response, order) for response in RESPONSES for order in (2, 4) if order == 4 or response == "squares"]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::aleator.ExpansionWarning")
@pytest.mark.parametrize(("response", "order"), SLOW)
def test_a_limit_on_a_quantile_is_at_its_optimum_or_not_ok(response, order):
    solution = largest(response, al.output("y").at_most(10.0, probability=LEVEL), order)
    exact = 10 / RESPONSES[response][1](LEVEL)
    assert not solution.ok or float(solution.decisions["d"]) == pytest.approx(exact, rel=1e-2)
    if response in ("squares", "product"):
        assert solution.ok


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::aleator.ExpansionWarning")
@pytest.mark.parametrize(("response", "order"), SLOW)
def test_a_limit_on_a_low_quantile_is_at_its_optimum_or_not_ok(response, order):
    function, of = RESPONSES[response]
    low = 8 - of(LEVEL) if response == "product" else of(1 - LEVEL)  # a product is symmetric about 4
    limit = al.output("y").at_least(low, probability=LEVEL)
    solution = largest(response, limit, order, least=low > 0)
    # The quantile is that of a size of 1, to a hundredth of its distance from the mean.
    nodes, weights = np.polynomial.hermite_e.hermegauss(12)
    mean = weights @ (function(nodes[:, None], nodes) * np.ones((12, 12))) @ weights / weights.sum() ** 2
    assert not solution.ok or abs(float(solution.decisions["d"]) - 1) * abs(low) <= 1e-2 * abs(mean - low)
    if response in ("exponential", "squares") and solution.ok:
        limit = low / float(solution.decisions["d"])
        beyond = stats.norm.cdf(np.log(limit) / 0.3) if response == "exponential" else stats.chi2(2).cdf(limit)
        assert beyond == pytest.approx(1 - LEVEL, rel=0.15)
    if response == "product":
        assert solution.ok


@pytest.mark.filterwarnings("ignore::aleator.ExpansionWarning")
def test_an_expansion_that_is_wrong_in_a_tail_is_contradicted_by_systems_there():
    limit = al.output("y").at_most(10.0, probability=0.9999)
    wrong, right = largest("exponential", limit, 2), largest("exponential", limit, 5)
    assert not wrong.ok
    assert "systems in its tail" in wrong.certificate.opinion.broken
    assert right.ok
    assert float(right.decisions["d"]) == pytest.approx(10 / np.exp(0.3 * U(0.9999)), rel=2e-3)


BROKEN_SELDOM = al.output("y").probability(above=10.0) <= 1e-3
MEAN_BEYOND = al.output("y").conditional_value_at_risk(0.99) <= 10.0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::aleator.ExpansionWarning")
@pytest.mark.parametrize(
    ("limit", "order", "exact"),
    [
        (BROKEN_SELDOM, 4, 10 / np.exp(0.3 * U(0.999))),
        (BROKEN_SELDOM, 2, None),
        (MEAN_BEYOND, 5, 10 / (np.exp(0.045) * stats.norm.sf(U(0.99) - 0.3) / 0.01)),
        (MEAN_BEYOND, 2, None),
    ],
)
def test_probabilities_and_means_beyond_quantiles_are_confirmed_too(limit, order, exact):
    solution = largest("exponential", limit, order)
    assert solution.ok == (exact is not None)
    assert exact is None or float(solution.decisions["d"]) == pytest.approx(exact, rel=1e-2)


Beam = algebraic(lambda w, f: {"stress": jnp.stack([f / w, 2 * f / w**2]), "w": w})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("limit", "exact"),
    [
        (al.output("stress").at_most(1.0, probability=0.9), 1 + 0.1 * U(0.9)),
        (al.output("stress").probability(above=1.0) <= 0.1, 1 + 0.1 * U(0.9)),
        (al.output("stress").conditional_value_at_risk(0.9) <= 1.0, 1 + 0.1 * stats.norm.pdf(U(0.9)) / 0.1),
    ],
)
def test_limits_on_tails_hold_for_every_entry_of_an_array(limit, exact):
    # Of the two stresses the second is the larger up to a width of two.
    model = Beam(al.Decision(3.0, 0.1, 9.0), al.Normal(1.0, 0.1))
    solution = al.solve(al.Problem(model, minimize=al.output("w").mean, subject_to=[limit]))
    assert solution.ok
    assert float(solution.decisions["w"]) == pytest.approx(np.sqrt(2 * exact), rel=1e-3)
    assert solution.constraints[0].active.ravel().tolist() == [False, True]


@pytest.mark.slow
@pytest.mark.parametrize("level", [0.45, 0.5, 0.55, 0.6])
def test_a_quantile_near_the_mean_is_confirmed(level):
    """Errors count as parts of the spread there: a distance from the mean of nearly zero is no measure."""
    model = algebraic(lambda d, x, y, z, u: {"y": d * (x * y + z * u)})(
        al.Decision(0.05, 0.01, 1.0), al.Normal(3.0, 0.6), al.Normal(2.0, 0.5), al.Normal(1.0, 0.3), al.Normal(4.0, 1.0)
    )
    limit = al.output("y").at_most(1.0, probability=level)
    solution = al.solve(al.Problem(model, minimize=-al.value("d"), subject_to=[limit]))
    x, y, z, u = np.random.default_rng(0).normal([3.0, 2.0, 1.0, 4.0], [0.6, 0.5, 0.3, 1.0], (10**6, 4)).T
    assert float(solution.decisions["d"]) == pytest.approx(1 / np.quantile(x * y + z * u, level), rel=5e-3)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::aleator.ExpansionWarning")
@pytest.mark.parametrize(("threshold", "is_ok"), [(0.5, True), (0.14, False)])
def test_a_probability_that_mean_and_spread_bound_needs_no_resolved_tail(threshold, is_ok):
    """By Cantelli's inequality `P[g > 0.5]` is below 2e-3 for a mean of 0.1 and a spread of 0.02."""
    model = algebraic(lambda a, x, y: {"g": y * jnp.sqrt((a * (x - 1)) ** 2 + 0.01)})(
        al.Decision(1.0, 0.3, 2.0), al.Gamma(shape=25.0, scale=1 / 25), al.Weibull(1.0, 6.0)
    )
    limit = al.output("g").probability(above=threshold) <= 0.05
    problem = al.Problem(model, minimize=al.value("a"), subject_to=[limit], expansion=al.Expansion(order=4))
    solution = al.solve(problem, throw=False)
    assert solution.certificate.expansion.worst > 0.05
    assert solution.ok == is_ok
    assert not is_ok or float(solution.decisions["a"]) == pytest.approx(0.3)


Curved = algebraic(lambda d, u, bend, slope: {"y": d + jnp.tanh(bend * u) + slope * u, "d": d})


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::aleator.ExpansionWarning")
@pytest.mark.parametrize(
    ("bend", "slope", "limit", "level"),
    [
        (1.37, 1.22, al.output("y").conditional_value_at_risk(0.95) <= 0.0, 0.95),
        (0.528, 0.511, al.output("y").quantile(0.02) >= 0.0, 0.02),
    ],
)
def test_what_is_said_of_a_tail_is_what_the_model_has_there(bend, slope, limit, level):
    """Statistics that followed the mean and spread of fresh systems had the wrong sign here."""
    model = Curved(al.Decision(0.0, -9.0, 9.0), al.Normal(0.0, 1.0), bend, slope)
    objective = (-1 if level > 0.5 else 1) * al.output("d").mean
    problem = al.Problem(model, minimize=objective, subject_to=[limit], expansion=al.Expansion(order=2))
    solution = al.solve(problem, throw=False)
    said = re.search(r"by the expansion, and (\S+) ± (\S+) by", solution.why())
    assert said is not None
    u = U(np.linspace(level, 1.0, 10**6 + 2)[1:-1])
    beyond = float(solution.decisions["d"]) + np.tanh(bend * u) + slope * u
    exact = beyond.mean() if level > 0.5 else beyond[0]
    assert float(said[1]) == pytest.approx(exact, abs=1.5 * float(said[2]))
    assert abs(float(said[2])) < abs(exact)


class TwoHumps(al.System):
    """Of two humps, the second is larger: but an expansion does not see its fast cosine."""

    states = ("rest",)
    size: al.Number
    u: al.Number

    def rhs(self, t, z):
        return (0.0 * z.rest,)

    def initial(self):
        return {"rest": 0.0}

    def outputs(self, t, z):
        first, second = jnp.exp(-((t - 1) ** 2) / 0.1), jnp.exp(-((t - 3) ** 2) / 0.1)
        humps = first * (1 + 0.2 * self.u) + 1.05 * second * (1 + 0.1 * self.u + 0.25 * jnp.cos(4 * self.u))
        return {"y": self.size * humps}


def largest_humps(limit):
    model = TwoHumps(al.Decision(1.0, 0.1, 5.0), al.Normal(0.0, 1.0))
    parts = {"minimize": -al.value("size"), "subject_to": [limit], "expansion": al.Expansion(3, tolerance=0.9)}
    return al.solve(al.Problem(model, grid=al.Grid(4.0, 40), **parts), throw=False)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::aleator.ExpansionWarning")
def test_tails_inside_an_integral_are_looked_into_where_they_would_change_most():
    solution = largest_humps(al.time_integral(al.path("y").quantile(0.95)) <= 2.0)
    # At its first instant, far from both humps, the expansion is right.
    assert "Q0.95[y(t)]" in solution.certificate.opinion.broken
    assert not solution.ok


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::aleator.ExpansionWarning")
@pytest.mark.parametrize(
    "limit", [al.path("y").at_most(2.0, probability=0.95), al.path("y").conditional_value_at_risk(0.9) <= 2.0]
)
def test_tails_are_looked_into_wherever_mean_and_spread_let_a_limit_break(limit):
    solution = largest_humps(limit)
    u = U(np.linspace(0.0, 1.0, 10**5 + 2)[1:-1])
    second = np.sort(float(solution.decisions["size"]) * 1.05 * (1 + 0.1 * u + 0.25 * np.cos(4 * u)))
    assert second[95 * len(second) // 100] > 2.05
    assert not solution.ok
    assert "systems in its tail" in solution.certificate.opinion.broken


@pytest.mark.slow
def test_a_quantile_whose_lines_scatter_is_confirmed_by_many_predictions():
    """Six products of neighbours in a ring: the replicates of lines scatter by ten times of what they are off."""
    ring = algebraic(lambda off, x: {"s": off + sum(x[i] * x[i - 1] for i in range(6))})
    model = ring(al.Decision(0.0, -50.0, 50.0), tuple(al.Normal(0.0, 1.0) for _ in range(6)))
    limit = al.output("s").at_most(0.0, probability=0.9)
    solution = al.solve(al.Problem(model, minimize=-al.value("off"), subject_to=[limit], expansion=al.Expansion(2)))
    x = np.random.default_rng(0).normal(size=(6, 10**6))
    exact = np.quantile(np.sum(x * np.roll(x, 1, axis=0), axis=0), 0.9)
    assert float(solution.decisions["off"]) == pytest.approx(-exact, abs=0.03)


# --- Limits on skewness and kurtosis ----------------------------------------------------------------------------------


Exponential = algebraic(lambda c, x: {"g": jnp.exp(c * x), "c": c})


def solved(c, x, limit, order, sign):
    """The design of the largest `sign * c` that meets a limit."""
    parts = {"minimize": -sign * al.output("c").mean, "subject_to": [limit], "expansion": al.Expansion(order)}
    return al.solve(al.Problem(Exponential(c, x), **parts), throw=False)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("limit", "of", "sign"),
    cases(
        [
            (al.output("g").skewness >= 0.4, scipy.stats.skew, 1),
            (al.output("g").kurtosis >= 3.5, lambda values: scipy.stats.kurtosis(values, fisher=False), 1),
        ]
    ),
    ids=["skewness", "kurtosis"],
)
def test_a_shape_that_polynomials_owe_to_what_never_occurs_is_no_answer(limit, of, sign):
    solution = solved(al.Decision(-0.5, -1.5, -0.05), al.Gamma(shape=0.6, scale=2.0), limit, 8, sign)
    values = np.exp(solution.decisions["c"] * scipy.stats.gamma(0.6, scale=2.0).ppf((np.arange(10**5) + 0.5) / 10**5))
    value = float(solution.constraints[0].values[0])
    assert abs(of(values) - value) > 0.4
    assert not solution.ok
    opinion = solution.certificate.opinion
    assert opinion is not None
    by = float(opinion.broken.split(" by ")[-1].split(" ± ")[0])
    assert by == pytest.approx(of(values) - value, rel=0.05)


@pytest.mark.parametrize(
    ("limit", "bound", "of"),
    cases(
        [
            (al.output("g").skewness <= 1.0, 1.0, "s"),
            (al.output("g").kurtosis <= 30.0, 27.0, "k"),  # SciPy tells the excess over 3
        ]
    ),
    ids=["skewness", "kurtosis"],
)
def test_a_shape_that_the_expansion_has_is_confirmed_though_its_tail_is_heavy(limit, bound, of):
    solution = solved(al.Decision(0.1, 0.05, 1.5), al.Normal(0.0, 1.0), limit, 10, 1)
    true = scipy.stats.lognorm(solution.decisions["c"]).stats(of)
    assert solution.ok
    assert float(true) == pytest.approx(bound, rel=1e-4)
