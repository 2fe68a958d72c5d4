"""Multi-element expansions of jumps, kinks and long times against closed forms, quadrature and plain sampling."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats

import aleator as al
from aleator.analysis._box import Box
from aleator.analysis._restricted_germ import RestrictedGerm
from aleator.uncertainty import HermiteGerm, JacobiGerm, LaguerreGerm, LegendreGerm

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


class Spring(al.System):
    states = ("x", "v")
    stiffness: float = al.parameter("N/m", positive=True)

    def rhs(self, t, z):
        return z.v, -self.stiffness * z.x

    def outputs(self, t, z):
        return {"x": z.x}

    def initial(self):
        return {"x": 1.0}


@pytest.mark.slow
def test_a_simulated_oscillator_is_followed_at_all_times():
    grid = al.Grid(50.0, 1500)
    pieces = al.expand(
        lambda m: al.simulate(m, grid), Spring(al.Uniform(1.0, half_width=0.5)), al.MultiElement(order=5)
    )
    times = np.asarray(grid.times)[::100]
    moments = [
        [integrate.quad(lambda k, p=p, t=t: np.cos(np.sqrt(k) * t) ** p, 0.5, 1.5, limit=400)[0] for t in times]
        for p in (1, 2)
    ]
    assert np.asarray(pieces.mean["x"][::100]) == pytest.approx(np.array(moments[0]), abs=1e-3)
    spread = np.sqrt(np.maximum(np.array(moments[1]) - np.array(moments[0]) ** 2, 0))
    assert np.asarray(pieces.std["x"][::100]) == pytest.approx(spread, abs=1e-3)


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


def test_a_jump_across_two_variables_converges_as_the_budget_grows():
    """A quarter disc: the error of a jump along a curve falls slowly, so the budget ends it, and that is said."""
    model = {"a": al.Uniform.bounds(0.0, 1.0), "b": al.Uniform.bounds(0.0, 1.0)}
    errors = []
    for budget in (500, 3_000):
        with pytest.warns(al.ExpansionWarning, match="elements leave an estimated error.*Raise the budget"):
            pieces = al.expand(
                lambda m: jnp.where(m["a"] ** 2 + m["b"] ** 2 < 1, 1.0, 0.0), model, al.MultiElement(2, budget=budget)
            )
        assert pieces.calls <= budget
        errors.append(abs(float(pieces.mean) - np.pi / 4))
    assert errors[1] < 5e-3
    assert set(pieces.splits) == {"a", "b"}


def test_kinked_responses_are_differentiable_through_the_distributions():
    def mean(h):
        return al.expand(
            lambda m: jnp.abs(m["w"] - 0.94), {"w": al.Uniform(1.0, half_width=h)}, al.MultiElement(error=1e-6)
        ).mean

    # E|w - c| = (h^2 + d^2) / (2 h) for d = 1 - c inside, whose derivative by h is 1/2 - d^2 / (2 h^2).
    assert float(mean(0.1)) == pytest.approx((0.01 + 0.0036) / 0.2, rel=1e-6)
    assert float(jax.grad(mean)(0.1)) == pytest.approx(0.5 - 0.0036 / 0.02, rel=1e-5)


def test_elements_cannot_be_sought_while_compiling():
    with pytest.raises(al.ProblemError, match=r"inside jax\.jit"):
        jax.jit(lambda h: al.expand(jump, {"w": al.Uniform(1.0, half_width=h)}, al.MultiElement()).mean)(0.3)


GERMS = [LegendreGerm(), HermiteGerm(), JacobiGerm(0.7, 0.6), LaguerreGerm(1.5)]
DENSITIES = [
    stats.uniform(-1, 2),
    stats.norm(),
    stats.beta(0.7, 0.6, loc=-1, scale=2),
    stats.gamma(1.5),
]


@pytest.mark.parametrize(("low", "high"), [(0.0, 0.25), (0.875, 1.0), (0.5, 0.5078125)])
@pytest.mark.parametrize(("germ", "distribution"), list(zip(GERMS, DENSITIES, strict=True)))
def test_moments_in_an_element_are_those_of_the_distribution_given_the_interval(germ, distribution, low, high):
    inside = RestrictedGerm(germ, low, high)
    nodes, weights = inside.gauss(6)
    first, last = distribution.ppf(low), distribution.ppf(high)
    for power in range(1, 8):
        exact = distribution.expect(lambda x, p=power: x**p, lb=first, ub=last, epsabs=0, epsrel=1e-11, limit=400) / (
            high - low
        )
        assert weights @ nodes**power == pytest.approx(exact, rel=1e-7)


@pytest.mark.parametrize(("low", "high"), [(0.0, 0.25), (0.25, 0.5)])
@pytest.mark.parametrize("germ", GERMS)
def test_levels_and_values_in_an_element_are_inverses_of_each_other(germ, low, high):
    inside = RestrictedGerm(germ, low, high)
    levels = np.linspace(0.01, 0.99, 21)
    values = inside.quantile(levels)
    assert inside.cumulative(values) == pytest.approx(levels, abs=1e-9)
    first, last = inside.support()
    assert np.all((first < values) & (values < last))
    assert inside.cumulative(np.array([values[0] - 100, values[-1] + 100])).tolist() == [0.0, 1.0]


def test_halves_share_the_probability_and_every_point_has_one_box():
    lower, upper = Box((0.0, 0.5), (1.0, 1.0)).halves(1)
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
