import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special, stats

import aleator as al
from compiling import compiled

CLUTCH = {"a": al.Normal(27.645, 0.05 / 3), "c": al.Normal(11.430, 0.01 / 3), "e": al.Normal(50.800, 0.0125 / 3)}
LIMITS = {"a": 0.05, "c": 0.01, "e": 0.0125}

DISTRIBUTIONS = {
    "u": (al.Uniform.bounds(1.0, 4.0), stats.uniform(1, 3)),
    "n": (al.Normal(-1.0, 0.3), stats.norm(-1, 0.3)),
    "b": (al.Beta(alpha=2.0, beta=5.0, upper=3.0), stats.beta(2, 5, 0, 3)),
    "g": (al.Gamma(shape=3.0, scale=0.5), stats.gamma(3, scale=0.5)),
}
MODEL = {name: distribution for name, (distribution, _) in DISTRIBUTIONS.items()}


def pressure_angle(m):
    return jnp.rad2deg(jnp.arccos((m["a"] + m["c"]) / (m["e"] - m["c"])))


def clutch_slopes():
    """By hand: chi = acos(p / q) with p = a + c and q = e - c, in degrees."""
    p, q = 27.645 + 11.430, 50.800 - 11.430
    outer = -1 / math.sqrt(1 - (p / q) ** 2)
    return {
        name: math.degrees(outer * inner) for name, inner in {"a": 1 / q, "c": 1 / q + p / q**2, "e": -p / q**2}.items()
    }


def test_the_direct_linearisation_of_the_clutch_is_the_published_one_and_tolerances_stack_up_as_by_hand():
    found, slopes = al.references.linearise(pressure_angle, CLUTCH), clutch_slopes()
    assert 3 * float(found.std) == pytest.approx(0.65788, abs=5e-6)  # dissertation, table 7.2
    # Its printed range, 6.3605 to 7.6763 degrees, has the middle 7.0184.
    assert float(found.mean) == pytest.approx(7.0184, abs=5e-5)
    parts = {name: abs(slope) * LIMITS[name] for name, slope in slopes.items()}
    assert float(found.worst_case(LIMITS)) == pytest.approx(sum(parts.values()), rel=1e-12)
    assert float(found.rss(LIMITS)) == pytest.approx(math.hypot(*parts.values()), rel=1e-12)
    # The distributions have a third of the limits as standard deviation.
    assert float(found.rss(LIMITS)) == pytest.approx(3 * float(found.std), rel=1e-12)
    total = sum(part**2 for part in parts.values())
    for name, part in parts.items():
        assert float(found.sensitivities[name]) == pytest.approx(slopes[name], rel=1e-10)
        assert float(found.contributions[name]) == pytest.approx(100 * part**2 / total, rel=1e-10)
    with pytest.raises(al.ProblemError, match=r"one tolerance for each of \['a', 'c', 'e'\]"):
        found.worst_case({"a": 0.05})


def moments_of_second_order(function, model):
    @compiled
    def moments():
        found = al.references.second_order(function, model)
        return found.mean, found.variance, found.skewness

    return tuple(map(float, moments()))


def quadratic(m):
    return (
        m["u"] ** 2 + 3 * m["u"] * m["n"] - m["n"] * m["b"] + 2 * m["g"] * m["u"] + 0.5 * m["g"] ** 2
        + 1.5 * m["n"] * m["g"] - 2 * m["b"] ** 2 + m["n"]
    )  # fmt: skip


def moments_by_quadrature(function, rules):
    """Mean, variance and skewness by the tensor product of Gauss rules."""
    grid = np.meshgrid(*[points for points, _ in rules.values()], indexing="ij")
    weight = np.prod(np.meshgrid(*[weights / weights.sum() for _, weights in rules.values()], indexing="ij"), axis=0)
    values = function(dict(zip(rules, grid, strict=True)))
    mean = np.sum(weight * values)
    variance = np.sum(weight * (values - mean) ** 2)
    return mean, variance, np.sum(weight * (values - mean) ** 3) / variance**1.5


def moved(rule, location, scale):
    return location + scale * rule[0], rule[1]


def test_second_order_moments_are_exact_for_a_quadratic_function_of_any_distributions():
    rules = {
        "u": moved(special.roots_legendre(4), 2.5, 1.5),
        "n": moved(special.roots_hermitenorm(4), -1.0, 0.3),
        "b": moved(special.roots_jacobi(4, 4.0, 1.0), 1.5, 1.5),
        "g": moved(special.roots_genlaguerre(4, 2.0), 0.0, 0.5),
    }
    exact = moments_by_quadrature(quadratic, rules)
    assert moments_of_second_order(quadratic, MODEL) == pytest.approx(exact, rel=1e-10)


def test_second_order_has_the_shift_and_the_skewness_of_the_clutch_that_linearisation_lacks():
    normal = special.roots_hermitenorm(10)
    rules = {name: moved(normal, one.parameters["mean"], one.parameters["std"]) for name, one in CLUTCH.items()}
    mean, variance, skewness = moments_by_quadrature(
        lambda m: np.rad2deg(np.arccos((m["a"] + m["c"]) / (m["e"] - m["c"]))), rules
    )
    first, second = al.references.linearise(pressure_angle, CLUTCH), moments_of_second_order(pressure_angle, CLUTCH)
    assert abs(second[0] - mean) < 0.02 * abs(float(first.mean) - mean)
    assert abs(second[1] - variance) < abs(float(first.variance) - variance)
    # What is left out of the skewness is smaller by the square of the spread, 0.22 in 7 degrees.
    assert second[2] == pytest.approx(skewness, rel=0.02)


def test_expansions_have_the_structure_of_the_outputs():
    def outputs(m):
        return {"path": m["u"] * np.outer(np.arange(3.0), np.ones(2)), "sum": m["u"] * m["n"]}

    first = al.references.linearise(outputs, MODEL)
    second = compiled(lambda: al.references.second_order(outputs, MODEL).std)()
    for std in (first.std, second):
        np.testing.assert_allclose(std["path"], np.outer(np.arange(3.0), np.ones(2)) * 3 / math.sqrt(12), rtol=1e-12)
    with pytest.raises(al.ProblemError, match="no output 'other'"):
        first["other"]
    np.testing.assert_allclose(first.contributions["u"]["path"], [[0, 0], [100, 100], [100, 100]], rtol=1e-12)
    assert first.sensitivities["n"]["sum"] == pytest.approx(2.5, rel=1e-12)
    assert first["sum"].worst_case(dict.fromkeys("unbg", 1.0)) == pytest.approx(2.5 + 1.0, rel=1e-12)


def test_what_does_not_vary_has_zero_spread_with_zero_derivative():
    def moments(level):
        second = al.references.second_order(lambda m: level + 0.0 * m["x"], {"x": al.Normal(1.0, 0.5)})
        first = al.references.linearise(lambda m: level + 0.0 * m["x"], {"x": al.Normal(1.0, 0.5)})
        return jnp.stack([second.std, second.skewness, first.std, first.contributions["x"]])

    values, slopes = compiled(lambda level: (moments(level), jax.jacrev(moments)(level)))(2.0)
    np.testing.assert_array_equal(values, 0.0)
    np.testing.assert_array_equal(slopes, 0.0)


def test_spreads_are_differentiable_in_the_distributions():
    def moments(w):
        model = {"x": al.Uniform(2.0, half_width=w)}
        first = al.references.linearise(lambda m: m["x"] ** 2, model)
        second = al.references.second_order(lambda m: m["x"] ** 2, model)
        return first.std, second.mean, second.variance

    w, m = 0.3, 2.0
    # Var x^2 = 4 m^2 w^2 / 3 + 4 w^4 / 45.
    exact = 2 * m / math.sqrt(3), 2 * w / 3, 8 * m**2 * w / 3 + 16 * w**3 / 45
    assert [float(slope) for slope in compiled(jax.jacrev(moments))(w)] == pytest.approx(exact, rel=1e-12)


def test_correlated_inputs_of_any_distribution_have_the_correlation_that_was_given():
    model = al.correlated({"c": al.LogNormal(mean=2.0, std=0.3), "e": al.Exponential(mean=0.4)}, {("c", "e"): -0.3})
    variance = compiled(lambda: al.references.linearise(lambda m: m["c"] + m["e"], model).variance)()
    assert float(variance) == pytest.approx(0.3**2 + 0.4**2 - 2 * 0.3 * 0.3 * 0.4, rel=1e-9)
    with pytest.raises(al.ProblemError, match=r"must be normal; received e ~ Exponential"):
        al.references.second_order(lambda m: m["c"] * m["e"], model)


def test_functions_that_cannot_be_expanded_are_refused():
    model = {"x": al.Normal(0.0, 1.0)}
    with pytest.raises(al.ProblemError, match="cannot differentiate"):
        al.references.linearise(lambda m: math.exp(m["x"]), model)
    with pytest.raises(al.SimulationError, match="not finite at the means"):
        al.references.linearise(lambda m: jnp.sqrt(m["x"]), model)
