"""Multi-element expansions of jumps, kinks and long times against closed forms, quadrature and plain sampling."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import aleator as al
from aleator.expansion._elements import Cell, RestrictedGerm
from aleator.uncertainty import HermiteGerm, JacobiGerm, LaguerreGerm, LegendreGerm
from compiling import compiled

WIDE = {"w": al.Uniform.bounds(0.7, 1.3)}


def jump(model):
    """A step response: 1 before the end stop at w = 0.83, 3 w after it."""
    return jnp.where(model["w"] > 0.83, 3 * model["w"], 1.0)


JUMP_MEAN = (0.13 + 1.5 * (1.3**2 - 0.83**2)) / 0.6
JUMP_VARIANCE = (0.13 + 3 * (1.3**3 - 0.83**3)) / 0.6 - JUMP_MEAN**2


def test_a_jump_that_order_10_does_not_follow_is_followed_by_elements():
    with pytest.warns(al.ExpansionWarning, match="does not resolve"):
        single = al.expand(jump, WIDE, al.Expansion(order=10))
    assert abs(float(single.std) ** 2 - JUMP_VARIANCE) > 1e-3
    pieces = al.expand(jump, WIDE, al.MultiElement())
    assert float(pieces.mean) == pytest.approx(JUMP_MEAN, abs=1e-3)
    assert float(pieces.variance) == pytest.approx(JUMP_VARIANCE, abs=1e-3)
    assert pieces.error <= 1e-3
    inputs = np.random.default_rng(0).uniform(0.7, 1.3, 50)
    for w in inputs[abs(inputs - 0.83) > 1e-3]:
        assert float(pieces({"w": w})) == pytest.approx(float(jump({"w": w})), abs=1e-3)


def test_a_jump_far_out_beside_a_straight_variable_is_divided_where_it_is():
    model = {"x": al.Normal(1.0, 0.2), "z": al.Uniform.bounds(1.0, 2.0)}
    pieces = al.expand(lambda m: jnp.where(m["x"] > 1.3, 1.0, 0.0) + m["z"], model, al.MultiElement(order=3))
    assert float(pieces.mean) == pytest.approx(1.5 + stats.norm.sf(1.5), abs=1e-5)
    assert pieces.error <= 1e-3


def test_elements_are_split_across_the_variable_that_needs_it():
    model = {"kinked": al.Uniform.bounds(0.0, 1.0), "smooth": al.Normal(0.0, 1.0)}
    pieces = al.expand(
        lambda m: jnp.abs(m["kinked"] - 0.37) + 0.1 * m["smooth"] ** 2, model, al.MultiElement(error=1e-4)
    )
    assert pieces.splits[:6] == ("kinked",) * 6
    assert pieces.splits.count("kinked") > pieces.splits.count("smooth")
    kink = (0.37**2 + 0.63**2) / 2, (0.37**3 + 0.63**3) / 3
    assert float(pieces.mean) == pytest.approx(kink[0] + 0.1, abs=1e-5)
    assert float(pieces.variance) == pytest.approx(kink[1] - kink[0] ** 2 + 0.02, abs=1e-5)


def test_systems_at_a_stop_are_neither_beyond_it_nor_short_of_it():
    # An element across the stop is a parabola.
    stopped = al.expand(lambda m: jnp.maximum(m["w"], 0.7), {"w": al.Normal(1.0, 1.0)}, al.MultiElement(order=2))
    assert float(stopped.probability(above=0.7)) == pytest.approx(stats.norm.sf(-0.3), abs=5e-3)
    assert float(stopped.probability(below=0.7)) == pytest.approx(0.0, abs=5e-3)
    constant = al.expand(lambda m: 0 * m["w"] + 2.0, {"w": al.Normal(1.0, 1.0)})
    assert float(constant.probability(above=2.0)) == 0.0
    assert float(constant.probability(above=1.9)) == 1.0


def test_a_jump_across_two_variables_ends_at_the_budget_and_says_so():
    """A quarter disc: the error of a jump along a curve falls slowly, so the budget ends it, and that is said."""
    model = {"a": al.Uniform.bounds(0.0, 1.0), "b": al.Uniform.bounds(0.0, 1.0)}
    with pytest.warns(al.ExpansionWarning, match="elements leave an estimated error.*Raise the budget"):
        pieces = al.expand(
            lambda m: jnp.where(m["a"] ** 2 + m["b"] ** 2 < 1, 1.0, 0.0), model, al.MultiElement(2, budget=1500)
        )
    assert pieces.calls <= 1500
    assert float(pieces.mean) == pytest.approx(np.pi / 4, abs=1e-2)
    assert set(pieces.splits) == {"a", "b"}


def test_elements_cannot_be_sought_while_compiling():
    with pytest.raises(al.ProblemError, match=r"inside jax\.jit"):
        jax.jit(lambda h: al.expand(jump, {"w": al.Uniform(1.0, half_width=h)}, al.MultiElement()).mean)(0.3)


ELEMENTS = [
    (LegendreGerm(), stats.uniform(-1, 2), 0.5, 0.5078125),
    (HermiteGerm(), stats.norm(), 0.875, 1.0),
    (JacobiGerm(0.7, 0.6), stats.beta(0.7, 0.6, loc=-1, scale=2), 0.0, 0.25),
    (LaguerreGerm(1.5), stats.gamma(1.5), 0.25, 0.5),
]


@pytest.mark.parametrize(("germ", "distribution", "low", "high"), ELEMENTS)
def test_moments_and_levels_in_an_element_are_those_of_the_distribution_given_the_interval(
    germ, distribution, low, high
):
    inside = RestrictedGerm(germ, low, high)
    nodes, weights = inside.gauss(6)
    first, last = distribution.ppf(low), distribution.ppf(high)
    for power in range(1, 8):
        exact = distribution.expect(lambda x, p=power: x**p, lb=first, ub=last, epsabs=0, epsrel=1e-11, limit=400) / (
            high - low
        )
        assert weights @ nodes**power == pytest.approx(exact, rel=1e-7)
    levels = np.linspace(0.01, 0.99, 21)
    values = inside.quantile(levels)
    assert values == pytest.approx(distribution.ppf(low + levels * (high - low)), rel=1e-8)
    assert inside.cumulative(values) == pytest.approx(levels, abs=1e-9)
    assert inside.cumulative(np.array([values[0] - 100, values[-1] + 100])).tolist() == [0.0, 1.0]


def test_halves_share_the_probability_and_every_point_has_one_box():
    lower, upper = Cell((0.0, 0.5), (1.0, 1.0)).halves(1)
    assert (lower.probability, upper.probability) == (0.25, 0.25)
    points = np.array([[0.2, 0.74], [0.2, 0.75], [1.0, 1.0], [0.0, 0.5]])
    assert lower.holds(points).tolist() == [True, False, False, True]
    assert upper.holds(points).tolist() == [False, True, True, False]


def test_a_jump_far_in_a_tail_that_the_first_samples_miss_is_found_at_fresh_points():
    distribution = stats.norm(1.0, 0.1)
    pieces = al.expand(lambda m: jnp.where(m["w"] > 1.2, m["w"], 0.0), {"w": al.Normal(1.0, 0.1)}, al.MultiElement())
    first, second = (distribution.expect(lambda x, p=p: x**p, lb=1.2, ub=3.0) for p in (1, 2))
    assert float(pieces.mean) == pytest.approx(first, abs=1e-6)
    assert float(pieces.variance) == pytest.approx(second - first**2, abs=1e-6)


def test_tails_over_elements_are_exact_far_out():
    expanded = al.expand(lambda at: jnp.abs(at["x"]), {"x": al.Normal(0.0, 1.0)}, al.MultiElement(order=2, error=1e-2))
    assert float(expanded.probability(above=4.5)) == pytest.approx(2 * stats.norm.sf(4.5), rel=1e-5)


def test_a_quantile_over_elements_grows_with_its_expansion():
    expanded = al.expand(lambda at: jnp.abs(at["x"]), {"x": al.Normal(0.0, 1.0)}, al.MultiElement(order=2, error=1e-2))

    def grown(factor):
        return eqx.tree_at(lambda one: one.coefficients, expanded, factor * expanded.coefficients).quantile(0.9)

    value, slope = compiled(jax.value_and_grad(grown))(1.0)
    assert [float(value), float(slope)] == pytest.approx([stats.norm.ppf(0.95)] * 2, abs=1e-7)
