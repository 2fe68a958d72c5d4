"""Limits on quantiles, probabilities and means beyond quantiles, against closed forms: the optimum, or not ok."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from scipy import stats

import aleator as al
from aleator.studies.suspension import RIDE, nominal, road
from zoo import algebraic, cases

U = stats.norm.ppf
# Responses of two normal numbers, with the quantile of each at a level: which, is data of the model.
RESPONSES = {
    "exponential": (lambda u, v: jnp.exp(0.3 * u), lambda p: np.exp(0.3 * U(p))),
    "reciprocal": (lambda u, v: 1 / (1 + 0.12 * u), lambda p: 1 / (1 - 0.12 * U(p))),
    "square of a reciprocal": (lambda u, v: 1 / (1 + 0.1 * u) ** 2, lambda p: 1 / (1 - 0.1 * U(p)) ** 2),
    "squares": (lambda u, v: u**2 + v**2, lambda p: -2 * np.log(1 - p)),
    # Bessel's K0 is the density of a product: the distribution function by SciPy's quadrature, inverted.
    "product": (lambda u, v: 4 + u * v, {0.9: 5.0344, 0.99: 6.9838, 0.9999: 11.2278}.get),
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


SLOW = [(response, level, order) for response in RESPONSES for level in (0.9, 0.9999) for order in (2, 4)]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::aleator.ExpansionWarning")
@pytest.mark.parametrize(("response", "level", "order"), SLOW)
def test_a_limit_on_a_quantile_is_at_its_optimum_or_not_ok(response, level, order):
    solution = largest(response, al.output("y").at_most(10.0, probability=level), order)
    exact = 10 / RESPONSES[response][1](level)
    assert not solution.ok or float(solution.decisions["d"]) == pytest.approx(exact, rel=1e-2)
    if response in ("squares", "product"):
        assert solution.ok


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::aleator.ExpansionWarning")
@pytest.mark.parametrize(("response", "level", "order"), SLOW)
def test_a_limit_on_a_low_quantile_is_at_its_optimum_or_not_ok(response, level, order):
    function, of = RESPONSES[response]
    low = 8 - of(level) if response == "product" else of(1 - level)  # a product is symmetric about 4
    limit = al.output("y").at_least(low, probability=level)
    solution = largest(response, limit, order, least=low > 0)
    # The quantile is that of a size of 1, to a hundredth of its distance from the mean.
    nodes, weights = np.polynomial.hermite_e.hermegauss(12)
    mean = weights @ (function(nodes[:, None], nodes) * np.ones((12, 12))) @ weights / weights.sum() ** 2
    assert not solution.ok or abs(float(solution.decisions["d"]) - 1) * abs(low) <= 1e-2 * abs(mean - low)
    if response in ("exponential", "squares") and solution.ok:
        limit = low / float(solution.decisions["d"])
        beyond = stats.norm.cdf(np.log(limit) / 0.3) if response == "exponential" else stats.chi2(2).cdf(limit)
        assert beyond == pytest.approx(1 - level, rel=0.15)
    if response == "product" or (response == "squares" and level < 0.999):  # whose lowest values few lines meet
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


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::aleator.ExpansionWarning", "ignore::aleator.GridWarning")
def test_a_limit_on_a_path_with_a_probability_is_active_and_held_by_systems_drawn_at_random():
    """The suspension with fewer steps: 0.9 of all cars keep the limit at each instant, at the worst one no more."""
    grid = al.Grid(2.8, 280)
    limit = al.path("travel").within(-0.22, 0.22, probability=0.9)
    options = {"minimize": RIDE.mean, "subject_to": [limit], "expansion": al.Expansion(order=2)}
    optimum = al.solve(al.Problem(nominal(), grid=grid, inputs={"road": road()}, **options), throw=False)
    assert optimum.certificate.violation < 1e-6
    stiffness, damping = (float(optimum.decisions[name]) for name in ("k_s.mean", "b_s.mean"))
    chosen = al.Uniform(stiffness, half_width=3750.0), al.Uniform(damping, half_width=250.0)
    car = eqx.tree_at(lambda car: (car.k_s, car.b_s), nominal(), chosen)
    travel = al.references.monte_carlo(
        lambda car: al.simulate(car, grid, inputs={"road": road()})["travel"], car, 4000
    ).values
    assert max(np.mean(travel > 0.22, axis=0).max(), np.mean(travel < -0.22, axis=0).max()) == pytest.approx(
        0.1, abs=0.02
    )


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
            (al.output("g").skewness <= 0.5, scipy.stats.skew, -1),
            (al.output("g").kurtosis >= 3.5, lambda values: scipy.stats.kurtosis(values, fisher=False), 1),
        ]
    ),
    ids=["lower", "upper", "kurtosis"],
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
