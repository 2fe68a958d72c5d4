"""Correlated distributions: the copula against OpenTURNS, closed forms and quadrature; realisation; refusals."""

import jax
import jax.numpy as jnp
import numpy as np
import openturns as ot
import pytest
from scipy import stats

import aleator as al
from aleator._core.arrays import numbers_to_arrays
from aleator._core.errors import ProblemError
from aleator.uncertainty import HermiteGerm, placements, realise
from compiling import compiled
from zoo import algebraic

NONE = np.zeros(0)
DATA = np.random.default_rng(8).gamma(3.0, size=200)

DISTRIBUTIONS = {
    "normal": al.Normal(1.0, 0.2),
    "uniform": al.Uniform(3.0, half_width=1.0),
    "exponential": al.Exponential(mean=2.0),
    "gumbel": al.Gumbel(0.0, 1.0),
    "weibull": al.Weibull(1.0, 1.5),
    "gamma": al.Gamma(mean=2.0, std=1.0),
    "sample": al.Sample(DATA),
    "toleranced": al.Toleranced(5.0, plus=0.2, minus=0.1),
}
TWO = {"a": DISTRIBUTIONS["normal"], "b": DISTRIBUTIONS["uniform"]}
THREE = TWO | {"c": DISTRIBUTIONS["gumbel"]}


def pair(first, second, correlation):
    return al.correlated({"a": DISTRIBUTIONS[first], "b": DISTRIBUTIONS[second]}, {("a", "b"): correlation})


def moments_by_quadrature(model, count=64):
    """Means, standard deviations and correlation of a correlated pair, by a product of Gauss-Hermite rules."""
    nodes, weights = HermiteGerm().gauss(count)
    germs = jnp.asarray(np.stack(np.meshgrid(nodes, nodes, indexing="ij"), axis=-1).reshape(-1, 2))
    weights = np.outer(weights, weights).ravel()
    values = compiled(jax.vmap(lambda germ: realise(model, germ, NONE)))(germs)
    a, b = np.asarray(values["a"]), np.asarray(values["b"])
    mean = np.array([weights @ a, weights @ b])
    covariance = np.cov(np.stack([a, b]), aweights=weights, ddof=0)
    std = np.sqrt(np.diag(covariance))
    return mean, std, covariance[0, 1] / std.prod()


def test_the_numbers_have_the_given_correlation_and_keep_their_own_moments():
    first, second, correlation, accuracy = "exponential", "weibull", -0.4, 1e-5
    mean, std, found = moments_by_quadrature(pair(first, second, correlation))
    assert found == pytest.approx(correlation, abs=accuracy)
    for i, name in enumerate((first, second)):
        assert mean[i] == pytest.approx(float(DISTRIBUTIONS[name].mean()), rel=10 * accuracy)
        assert std[i] == pytest.approx(float(DISTRIBUTIONS[name].std()), rel=30 * accuracy)


def test_normals_have_the_correlation_that_was_given_and_lognormals_and_uniforms_that_of_the_closed_form():
    assert pair("normal", "toleranced", 0.3)["b"].dependence.factor[1, 0] == pytest.approx(0.3, rel=1e-13)
    s, t = np.sqrt(np.log(1 + 0.4**2)), np.sqrt(np.log(1 + 0.3**2))
    distributions = {"a": al.LogNormal(mean=2.0, std=0.8), "b": al.LogNormal(mean=1.0, std=0.3, lower=0.0)}
    for r in (0.9, 0.2, -0.7):
        rho = al.correlated(distributions, {("a", "b"): r})["b"].dependence.factor[1, 0]
        assert rho == pytest.approx(np.log(1 + r * 0.4 * 0.3) / (s * t), rel=1e-12)
    for r in (-0.9, 0.1, 0.95):
        rho = pair("uniform", "uniform", r)["b"].dependence.factor[1, 0]
        assert rho == pytest.approx(2 * np.sin(np.pi * r / 6), rel=1e-7)


def test_realisations_are_those_of_openturns_normal_copula():
    r = np.array([[1.0, 0.4, -0.2], [0.4, 1.0, 0.3], [-0.2, 0.3, 1.0]])
    distributions = {"a": al.Normal(1.0, 0.2), "b": al.Gamma(shape=4.0, scale=0.5), "c": al.Weibull(2.0, 1.5)}
    model = al.correlated(distributions, r)
    factor = model["a"].dependence.factor
    marginals = [ot.Normal(1.0, 0.2), ot.Gamma(4.0, 2.0), ot.WeibullMin(2.0, 1.5)]
    joint = ot.JointDistribution(marginals, ot.NormalCopula(ot.CorrelationMatrix((factor @ factor.T).tolist())))
    points = np.random.default_rng(0).normal(size=(7, 3))
    to_numbers = joint.getInverseIsoProbabilisticTransformation()
    arrays = numbers_to_arrays(model)
    assert placements(arrays).germ_names == placements(model).germ_names
    ours = compiled(jax.vmap(lambda germ: realise(arrays, germ, NONE)))(points)
    ours = np.stack([np.asarray(ours[name]) for name in "abc"], axis=1)
    assert ours == pytest.approx(np.array(to_numbers(ot.Sample(points.tolist()))), rel=1e-8)
    ot.RandomGenerator.SetSeed(1)
    sampled = np.array(joint.getSample(100_000).computeLinearCorrelation())
    assert sampled == pytest.approx(r, abs=4 / np.sqrt(100_000))  # four standard errors


def test_decisions_inside_correlated_distributions_move_them_and_leave_the_copula():
    distributions = {
        "a": al.Normal(1.0, al.Decision(0.2, 0.0, 1.0)),
        "b": al.Gamma(mean=al.Decision(2.0, 1.0, 4.0), std=1.0),
    }
    model = al.correlated(distributions, {("a", "b"): 0.5})
    fixed = al.correlated({"a": al.Normal(1.0, 0.2), "b": al.Gamma(mean=2.0, std=1.0)}, {("a", "b"): 0.5})
    factor = fixed["a"].dependence.factor
    assert np.array_equal(model["a"].dependence.factor, factor)
    assert tuple(placements(model).decisions) == ("a.std", "b.mean")
    germ, x = np.array([0.4, -0.9]), np.array([0.3, 2.5])
    real, slopes = compiled(lambda x: (realise(model, germ, x), jax.jacfwd(lambda x: realise(model, germ, x))(x)))(x)
    normal = factor @ germ

    def oracle(x):
        return stats.gamma(x**2, scale=1 / x).ppf(stats.norm.cdf(normal[1]))

    assert float(real["a"]) == pytest.approx(1.0 + 0.3 * normal[0], rel=1e-14)
    assert float(real["b"]) == pytest.approx(oracle(2.5), rel=1e-9)
    h = 1e-3
    near, far = (oracle(2.5 + k * h) - oracle(2.5 - k * h) for k in (1, 2))
    assert np.asarray(slopes["b"]) == pytest.approx([0.0, (8 * near - far) / (12 * h)], rel=1e-7)


def test_a_spread_may_be_differentiated_from_outside_and_a_shape_may_not():
    germ = jnp.array([0.4, -0.9])

    def number(s, make):
        return realise(al.correlated(TWO | {"b": make(s)}, {("a", "b"): 0.5}), germ, NONE)["b"]

    normal = 0.5 * 0.4 - np.sqrt(0.75) * 0.9
    slope = compiled(jax.grad(lambda s: number(s, lambda s: al.Normal(1.0, s))))(0.3)
    assert float(slope) == pytest.approx(normal, rel=1e-12)
    for make in (lambda s: al.Weibull(1.0, s), lambda s: al.LogNormal(mean=1.0, std=s)):
        with pytest.raises(ProblemError, match=r"shape of a correlated distribution cannot be traced.*plain number"):
            compiled(jax.grad(number), static_argnums=1)(0.3, make)


def test_a_member_may_stand_at_two_places_if_it_is_said_to_be_one():
    distributions = pair("normal", "gumbel", 0.5)
    with pytest.raises(ProblemError, match="'a' of the correlated group 'a~b' is placed twice, at 'x' and at 'y'"):
        placements({"x": distributions["a"], "y": distributions["a"], "z": distributions["b"]})
    shared = distributions["a"].shared("s")
    model = {"x": shared, "y": shared, "z": distributions["b"]}
    real = compiled(lambda at: realise(model, at, NONE))(np.array([0.5, 0.1]))
    assert float(real["x"]) == float(real["y"]) == pytest.approx(1.1, rel=1e-14)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: al.correlated(TWO, [[1.0, 0.5], [0.4, 1.0]]),
            "symmetric .*received 0.5 for 'a' and 'b', 0.4 for 'b' and 'a'",
        ),
        (lambda: al.correlated(TWO, [[1.0, 1.0], [1.0, 1.0]]), "between -1 and 1.*`shared`.*received 1 for"),
        (
            lambda: al.correlated(TWO, {("a", "x"): 0.5}),
            r"pairs of two of the distributions a, b; received \('a', 'x'\)",
        ),
        (
            lambda: al.correlated(THREE, {("a", "b"): 0.9, ("b", "c"): 0.9, ("a", "c"): -0.9}),
            "contradict each other.*positive definite.*smallest eigenvalue -0.8.*closer to 0",
        ),
    ],
)
def test_correlations_that_cannot_be_are_refused_with_the_entry_and_the_remedy(make, message):
    with pytest.raises(ProblemError, match=message):
        make()


def test_the_lowest_correlation_of_two_exponentials_is_one_less_pi_squared_over_six():
    lowest = 1 - np.pi**2 / 6
    pair("exponential", "exponential", lowest + 1e-3)
    with pytest.raises(ProblemError, match=r"cannot have the correlation -0\.64.* between -0\.6449"):
        pair("exponential", "exponential", lowest - 1e-3)


# --- Correlations that decided shapes move away from those given ------------------------------------------------------


Sum = algebraic(lambda a, b: {"y": a + b})


def problem(first, second, rho=0.6):
    """The cheapest spreads of two numbers whose sum spreads by 1.2."""
    pair = al.correlated({"a": first, "b": second}, {("a", "b"): rho})
    cost = [al.cost.reciprocal(f"{name}.std", bias=0.0, scale=0.1) for name in pair]
    limit = al.output("y").std <= 1.2
    return al.Problem(Sum(**pair), minimize=cost[0] + cost[1], subject_to=[limit], expansion=al.Expansion(order=8))


def lognormals(start):
    return [al.LogNormal(mean=1.0, std=al.Decision(start, 0.02, 3.0)) for _ in range(2)]


def pearson(start, std, rho=0.6):
    """Of two lognormals of mean 1, whose copula gives them the correlation `rho` at another spread."""
    normal = np.log1p(rho * start**2) / np.log1p(start**2)
    return np.expm1(normal * np.log1p(std**2)) / std**2


def test_correlations_that_a_decided_shape_moves_are_told_and_solving_again_regains_them():
    with pytest.warns(al.CorrelationWarning, match="0.554 between a and b in place of 0.6") as caught:
        solution = al.solve(problem(*lognormals(0.05)))
    assert len(caught) == 1
    assert pearson(0.05, solution.decisions["a.std"]) == pytest.approx(0.554, abs=5e-4)
    again = al.solve(problem(*lognormals(1.2 / np.sqrt(2 * 1.6))))  # where it ends if it is solved again and again
    assert not again.certificate.correlations
    assert again.decisions["a.std"] == pytest.approx(1.2 / np.sqrt(2 * 1.6), rel=2e-3)
