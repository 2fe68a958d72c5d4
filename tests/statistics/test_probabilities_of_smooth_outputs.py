"""Probabilities in few variables: to 1e-8 where an output rises along one of them, elsewhere within their error."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special, stats
from small_expansions import basis_of, coefficients_of_polynomial

import aleator as al
from aleator.statistics import ConditionalValueAtRisk, Probability, Quantile, lines_through, sloped
from aleator.uncertainty import HermiteGerm

GRAVITY, SPEED, ANGLE, HEIGHT = 9.81, (20.0, 0.3), (0.785, 0.1), (3.0, 0.3)


def flight(at):
    """How far a ball flies that is thrown from a height."""
    forward, upward = at["speed"] * jnp.cos(at["angle"]), at["speed"] * jnp.sin(at["angle"])
    return forward / GRAVITY * (upward + jnp.sqrt(upward**2 + 2 * GRAVITY * at["height"]))


def normal(mean, std):
    return al.Normal(mean, std), stats.norm(mean, std)


def uniform(mean, std):
    reach = np.sqrt(3) * std
    return al.Uniform(mean, half_width=reach), stats.uniform(mean - reach, 2 * reach)


def rule(distribution, nodes=400):
    """Gauss's rule over 7.5 standard deviations, or over the support."""
    low, high = (distribution.mean() + side * 7.5 * distribution.std() for side in (-1, 1))
    low, high = max(low, distribution.ppf(0.0)), min(high, distribution.ppf(1.0))
    at, weights = special.roots_legendre(nodes)
    at = (low + high) / 2 + (high - low) / 2 * at
    return at, distribution.pdf(at) * weights * (high - low) / 2


def chance_of_more(distance, speed, angle, height):
    """The probability of a longer flight: the speed for a distance in closed form, the other two by Gauss."""
    (angles, by_angle), (heights, by_height) = rule(angle), rule(height)
    angles = angles[:, None]
    needed = np.sqrt(GRAVITY * distance**2 / (2 * np.cos(angles) ** 2 * (distance * np.tan(angles) + heights)))
    return by_angle @ speed.sf(needed) @ by_height


@functools.cache
def expanded(*kinds):
    numbers = {"speed": SPEED, "angle": ANGLE, "height": HEIGHT}
    both = {name: kind(*own) for kind, (name, own) in zip(kinds, numbers.items(), strict=True)}
    inputs, oracles = ({name: one[k] for name, one in both.items()} for k in (0, 1))
    return al.expand(flight, inputs, al.Expansion(10, points=al.points.GaussPoints())), oracles


def test_the_flight_of_a_ball_with_three_uncertain_numbers_has_eight_digits():
    """At the angle of the longest flight, along which the output turns: lines along the speed find all of it."""
    made, oracles = expanded(normal, uniform, uniform)
    mean, std, lines = float(made.mean), float(made.std), lines_through(made.basis)
    for away in (-1.0, 1.0):
        distance = mean + away * std
        right = chance_of_more(distance, **oracles)
        estimate, error = Probability(above=distance).estimated(made.coefficients, lines)
        assert float(estimate) == pytest.approx(right, abs=1e-8)
        assert float(error) < 1e-6
    assert float(made.quantile(1 - right)) == pytest.approx(distance, abs=1e-7 * std)


@pytest.mark.slow
def test_where_the_speed_that_is_needed_leaves_its_support_errors_cover():
    made, oracles = expanded(uniform, uniform, uniform)
    mean, std, lines = float(made.mean), float(made.std), lines_through(made.basis)
    for away in (-1.5, 0.0):
        estimate, error = Probability(above=mean + away * std).estimated(made.coefficients, lines)
        assert 1e-6 < float(error) < 1e-3
        assert float(estimate) == pytest.approx(chance_of_more(mean + away * std, **oracles), abs=float(error))


def test_slopes_by_lines_along_a_variable_are_those_of_differences():
    basis = basis_of([HermiteGerm()] * 3, 2)
    coefficients = np.asarray(coefficients_of_polynomial(basis, lambda a, b, c: a - b**2 + 0.2 * a * c + 0.1 * c))
    lines, direction = lines_through(basis), np.random.default_rng(0).normal(size=coefficients.shape)
    for kind in (Probability(above=0.3), Quantile(0.3), ConditionalValueAtRisk(0.7)):
        known = sloped(kind, coefficients[:, None], lines)
        ahead, behind = (
            float(sloped(kind, (coefficients + step * direction)[:, None], lines).values[0]) for step in (1e-4, -1e-4)
        )
        assert known.slopes[:, 0] @ direction == pytest.approx((ahead - behind) / 2e-4, rel=1e-5)


@pytest.mark.parametrize("chance", [0.1, 1e-2, 1e-4])
def test_slopes_around_a_circle_that_lines_touch_are_those_of_the_closed_form(chance):
    """`P[s (a² + b²) + m > x] = exp(-(x - m) / (2 s))`."""
    basis, threshold = basis_of([HermiteGerm()] * 2, 2), -2 * np.log(chance)
    coefficients = np.asarray(coefficients_of_polynomial(basis, lambda a, b: a**2 + b**2))
    known = sloped(Probability(above=threshold), coefficients[:, None], lines_through(basis))
    assert known.slopes[0, 0] == pytest.approx(chance / 2, rel=1e-2)
    assert known.slopes[:, 0] @ coefficients == pytest.approx(threshold * chance / 2, rel=1e-2)


def test_densities_and_traced_derivatives_are_those_of_the_closed_forms():
    """Of the product of two numbers that are uniform from 1 to 2, and of the square of a distance in the plane."""
    sides = {name: al.Uniform.bounds(1.0, 2.0) for name in ("a", "b")}
    area = al.expand(lambda at: at["a"] * at["b"], sides, al.Expansion(order=2))
    values = np.array([1.2, 1.7, 2.3, 3.6])
    exact = np.where(values < 2, np.log(values), np.log(4 / values))
    assert np.asarray(area.pdf(jnp.array(values))) == pytest.approx(exact, rel=1e-5)

    plane = {name: al.Normal(0.0, 1.0) for name in ("a", "b")}

    def tail(scale, value, level):
        square = al.expand(lambda at: scale * (at["a"] ** 2 + at["b"] ** 2), plane, al.Expansion(order=2))
        return square.probability(above=value), square.conditional_value_at_risk(level)

    chance, beyond = jax.jit(jax.jacfwd(tail, argnums=(0, 1, 2)))(1.0, 4.0, 0.9)
    # P[y > v] = exp(-v / (2 s)); the mean above the quantile at l is 2 s (1 - log(1 - l)).
    exact = np.exp(-2.0)
    assert np.asarray(chance) == pytest.approx([2 * exact, -exact / 2, 0.0], rel=1e-2)
    assert np.asarray(beyond) == pytest.approx([2 * (1 + np.log(10)), 0.0, 20.0], rel=1e-2)


class Pushed(al.System):
    """A place that is zero at the start, whatever the gain."""

    states = ("x",)
    gain: al.Number = al.Uniform(1.0, half_width=0.2)

    def rhs(self, t, z, push):
        return (self.gain * push,)

    def outputs(self, t, z):
        return {"x": z.x}


def test_a_quantile_along_a_path_may_begin_where_nothing_varies():
    limit = al.path("x").at_most(1.0, probability=0.9)
    push = al.Control(0.2, 0.0, 5.0)
    problem = al.Problem(
        Pushed(), grid=al.Grid(2.0, 20), inputs={"push": push}, minimize=-1 * al.terminal("x").mean, subject_to=[limit]
    )
    # The gain stays below 1.16 with probability 0.9.
    assert al.solve(problem).objective == pytest.approx(-1 / 1.16, rel=1e-6)
