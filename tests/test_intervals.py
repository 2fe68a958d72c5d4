"""Numbers known to lie in an interval, without any probability: bounds of statistics, and designs for the worst."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm, weibull_min

import aleator as al
from compiling import compiled
from zoo import Decay, Oscillator, sine

SPREAD = 0.2


# --- Designs ---------------------------------------------------------------------------------------------------------

RULES = {
    "linear": (lambda a, z: a * (1.0 + z), 2.0, 2.0),
    "a maximum inside": (lambda a, z: jnp.sin(a) * (1.0 + z), 1.0, np.pi / 2),
    "two maxima inside": (lambda a, z: (jnp.cos(4 * a) + 0.1 * a) * (1.0 + z), None, None),
    "not at all": (lambda a, z: 0.0 * a + z, None, None),
}


class Part(al.AlgebraicSystem):
    """A strength, and a load that is a rule of a random and of an unknown number: which rule, is data."""

    strength: al.Number
    z: al.Number
    a: al.Number
    weights: Any

    def outputs(self):
        rules = (rule(self.a, self.z) for rule, *_ in RULES.values())
        return {
            "load": sum(weight * one for weight, one in zip(self.weights, rules, strict=True)),
            "strength": self.strength,
            "off": (self.strength - self.a) ** 2 + self.z,
        }


LOAD, OFF = al.output("load"), al.output("off")
STRENGTH = al.output("strength").mean


def part(name: str = "linear", a: Any = None, z: Any = None) -> Part:
    weights = np.array([float(one == name) for one in RULES])
    z = al.Normal(0.0, SPREAD) if z is None else z
    return Part(al.Decision(5.0, 0.0, 20.0), z, al.Interval(-1.0, 2.0) if a is None else a, weights)


def weakest(name: str = "linear", **numbers: Any) -> al.Problem:
    """The least strength that the load does not exceed by two standard deviations."""
    limit = (LOAD.mean + 2 * LOAD.std <= al.value("strength")).named("load")
    return al.Problem(part(name, **numbers), minimize=STRENGTH, subject_to=[limit])


def worst_of(solution: al.Solution) -> Any:
    assert solution.certificate.worst_case is not None
    return solution.certificate.worst_case.realisations


def tried(name: str) -> tuple[float, float]:
    """The largest mean load plus two standard deviations over the interval, and where, by trying many values."""
    values = np.linspace(-1.0, 2.0, 300_001)
    rule = compiled(RULES[name][0])
    # All rules are affine in the random number.
    mean = np.asarray(rule(values, 0.0))
    slope = np.asarray(rule(values, 1.0)) - mean
    highest = mean + 2 * SPREAD * np.abs(slope)
    return float(highest.max()), float(values[np.argmax(highest)])


@pytest.mark.parametrize("name", RULES)
def test_a_limit_holds_for_the_worst_value_wherever_it_lies(name):
    _, load, where = RULES[name]
    highest, place = tried(name) if load is None else ((1 + 2 * SPREAD) * load, where)
    solution = al.solve(weakest(name))
    assert solution.decisions == {"strength": pytest.approx(highest, rel=1e-6)}
    assert solution.objective == pytest.approx(highest, rel=1e-6)
    assert solution.multiplier("load") == pytest.approx(1.0, rel=1e-5)
    worst, _ = worst_of(solution)
    assert worst.beyond <= 1e-6 * highest
    if name != "not at all":
        assert worst.numbers == {"a": pytest.approx(place, abs=1e-3)}


def test_an_objective_is_its_worst_value_over_the_interval():
    # The middle of the interval: both ends are equally far.
    solution = al.solve(al.Problem(part(), minimize=OFF.mean))
    assert solution.decisions["strength"] == pytest.approx(0.5, abs=1e-5)
    assert solution.objective == pytest.approx(1.5**2)
    ends = {round(float(one.vector[-1]), 6): one.objective for one in solution.over_intervals}
    assert ends[-1.0] == pytest.approx(1.5**2, abs=1e-5)
    assert ends[2.0] == pytest.approx(1.5**2, abs=1e-5)


def test_a_design_for_the_worst_damping_is_found_from_afar():
    """The trough of an undamped oscillation is `-v / ω`, and its search ends between two instants on the way."""

    class Struck(Oscillator):
        def initial(self):
            return {"v": self.x0}

    system = Struck(1.0, al.Interval(0.0, 4.0), al.Decision(30.0, 5.0, 300.0), al.Normal(1.0, 0.05))
    limit, still = al.path("x").within(-0.1, 0.12, sigmas=2), {"force": sine(0.0)}
    problem = al.Problem(system, grid=al.Grid(1.0, 40), inputs=still, minimize=al.value("k"), subject_to=[limit])
    with pytest.warns(al.GridWarning, match="tolerated"):
        solution = al.solve(problem)
    assert solution.decisions["k"] == pytest.approx((1.1 / 0.1) ** 2, rel=1e-4)


@pytest.mark.slow
def test_a_parameter_of_a_distribution_may_be_an_interval():
    # sup of a (1 + m + 2 s) over m and s: both at their upper ends.
    z = al.Normal(al.Interval(-0.1, 0.1), al.Interval(0.1, 0.3))
    solution = al.solve(weakest(a=2.0, z=z))
    assert solution.decisions["strength"] == pytest.approx(2.0 * (1.1 + 2 * 0.3))
    assert worst_of(solution)[0].numbers == {"z.mean": 0.1, "z.std": 0.3}


@pytest.mark.slow
def test_the_least_strength_of_a_small_probability_of_failure_and_its_share_of_violations_are_bounded():
    # P[a (1 + Z) > strength] = 0.01 at a = 2, and next to nothing at a = 0.5.
    limits = [LOAD.quantile(0.99) <= al.value("strength"), LOAD.at_most(2.9, sigmas=2)]
    solution = al.solve(al.Problem(part(a=al.Interval(0.5, 2.0)), minimize=STRENGTH, subject_to=limits))
    assert solution.decisions["strength"] == pytest.approx(2.0 * norm.ppf(0.99, 1.0, SPREAD), rel=1e-6)
    evidence = al.validate(solution, 20_000)
    least, largest = evidence.least_violation("load"), evidence.violation("load")
    assert least.count == 0
    assert largest.lower <= norm.sf(2.9, 2.0, 2 * SPREAD) <= largest.upper
    assert f"{least} to {largest}" in str(evidence)
    assert evidence.agrees


# --- Expansions ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_sum_of_an_interval_and_a_normal_number_has_the_probability_box_of_two_normal_distributions():
    box = al.expand(lambda one: one["a"] + one["z"], {"a": al.Interval(-1.0, 2.0), "z": al.Normal(0.0, 1.0)})
    values = np.linspace(-3.0, 4.0, 15)
    bounds = box.cdf(values)
    np.testing.assert_allclose(bounds.lower, norm.cdf(values, 2.0), atol=1e-6)
    np.testing.assert_allclose(bounds.upper, norm.cdf(values, -1.0), atol=1e-6)
    np.testing.assert_allclose([box.mean.lower, box.mean.upper], [-1.0, 2.0], atol=1e-12)
    np.testing.assert_allclose([box.std.lower, box.std.upper], [1.0, 1.0], rtol=1e-12)
    assert box.quantile(0.9).upper == pytest.approx(norm.ppf(0.9, 2.0))
    assert box.quantile(0.9).at_upper == {"a": pytest.approx(2.0)}
    chance = box.probability(above=2.5)
    assert (chance.lower, chance.upper) == (pytest.approx(norm.sf(3.5)), pytest.approx(norm.sf(0.5)))


@pytest.mark.slow
def test_the_least_of_a_small_probability_is_found_where_it_is_a_millionth_of_others():
    rule = {"mean": al.Interval(0.1, 0.35), "load": al.Normal(al.Interval(2.0, 3.0), al.Interval(0.2, 0.4))}
    expanded = al.expand(lambda one: 10 * (one["mean"] - 0.24) ** 2 + one["load"], rule)
    chance = expanded.probability(above=3.1)
    assert float(chance.lower) == pytest.approx(norm.sf(5.5), rel=1e-3)
    assert chance.at_lower["mean"] == pytest.approx(0.24, abs=1e-3)
    assert float(chance.upper) == pytest.approx(norm.sf((3.1 - 3 - 10 * 0.14**2) / 0.2), rel=1e-6)


def test_bounds_are_found_inside_and_of_each_output():
    model = {"a": al.Interval(0.0, 3.0), "z": al.Normal(0.0, 0.1)}
    outputs = al.expand(
        lambda one: {"wave": jnp.sin(one["a"]) * (1 + one["z"]), "square": (one["a"] - 1) ** 2 + one["z"]},
        model,
        al.Expansion(order=11),
    )
    wave, square = outputs["wave"], outputs["square"]
    assert wave.mean.upper == pytest.approx(1.0, abs=1e-6)
    assert wave.std.upper == pytest.approx(0.1, rel=1e-6)
    assert wave.std.at_upper["a"] == pytest.approx(np.pi / 2, abs=1e-3)
    assert square.mean.lower == pytest.approx(0.0, abs=1e-8)
    assert square.mean.at_lower["a"] == pytest.approx(1.0, abs=1e-3)
    assert outputs.mean["square"].upper == pytest.approx(4.0)
    ratio = outputs.bounds(lambda given: given["wave"].std / (1 + given["square"].mean))
    values = np.linspace(0.0, 3.0, 100_001)
    assert ratio.upper == pytest.approx(np.max(0.1 * np.abs(np.sin(values)) / (1 + (values - 1) ** 2)), rel=1e-5)
    assert outputs.at({"a": 1.0})["wave"].mean == pytest.approx(np.sin(1.0), abs=1e-6)


def test_a_spread_that_is_not_followed_where_an_interval_ends_is_warned_of():
    # At the shape 4 the exact spread is 0.2543.
    with pytest.warns(al.ExpansionWarning, match=r"At w\.shape = 4 the expansion of order 6 errs"):
        spread = al.expand(
            lambda one: one["w"], {"w": al.Weibull(1.0, al.Interval(1.0, 4.0))}, al.Expansion(order=6)
        ).std
    assert spread.lower == pytest.approx(weibull_min(4.0).std(), rel=0.1)


def test_histories_have_bounds_at_each_instant_and_derivatives_at_values_of_the_interval():
    times = np.linspace(0.0, 1.0, 41)

    def decay(one):
        return jnp.exp(-one["rate"] * times) * one["x"]

    def spread(std):
        return al.expand(decay, {"rate": al.Interval(0.5, 2.0), "x": al.Normal(1.0, std)}, al.Expansion(order=8))

    bounds = spread(0.1).mean
    np.testing.assert_allclose(bounds.lower, np.exp(-2.0 * times), atol=1e-6)
    np.testing.assert_allclose(bounds.upper, np.exp(-0.5 * times), atol=1e-6)
    np.testing.assert_allclose(bounds.at_lower["rate"][1:], 2.0)
    slope = compiled(jax.grad(lambda std: spread(std).at({"rate": 2.0}).std[-1]))(0.1)
    assert float(slope) == pytest.approx(np.exp(-2.0), rel=1e-5)
    with pytest.raises(al.ProblemError, match=r"outside of jax\.grad"):
        compiled(jax.grad(lambda std: spread(std).std.upper[-1]))(0.1)


# --- What is said ----------------------------------------------------------------------------------------------------

Z = al.Uniform(0.0, half_width=0.3)
WITH_BOTH = {"a": al.Interval(-1.0, 2.0), "z": al.Normal(0.0, 1.0)}


def product(one):
    return one["a"] * one["z"]


@pytest.mark.parametrize(
    ("declare", "match"),
    [
        (lambda: al.Interval(2.0, 1.0), "expected lower < upper; received 2 and 1"),
        (lambda: al.Interval(al.Decision(1.0), 2.0), r"share=al\.Interval\(-1\.0, 1\.0\)"),
        (
            lambda: al.Problem(part(z=Z), minimize=STRENGTH, subject_to=[LOAD.at_most(9.0, worst_case=True)]),
            "declare 'a' as an al.Uniform",
        ),
        (
            lambda: al.Problem(Part(al.Integer(5, 0, 9), 0.1, al.Interval(0.0, 1.0), np.ones(4)), minimize=STRENGTH),
            "al.Integer or al.Choice: 'a' is an al.Interval",
        ),
        (
            lambda: al.Problem(
                Decay(al.Interval(1.0, 2.0), al.Normal(0.0, 0.1)),
                grid=al.Grid(1.0, 10),
                minimize=al.terminal("x").std,
                feedback=al.Feedback(gains=[1.0], of=("x",)),
            ),
            "feedback: 'rate' is an al.Interval",
        ),
        (lambda: al.conflict(weakest()), "Limits are held for all of its values by al.solve"),
        (lambda: al.solve(weakest(), al.solvers.NelderMead()), "a solver by derivatives"),
        (lambda: al.solve(weakest(), transcription=al.Simultaneous()), r"expected transcription=al\.Sequential"),
        (lambda: al.references.monte_carlo(product, WITH_BOTH), "monte_carlo: 'a' is an al.Interval"),
        (lambda: al.correlated(WITH_BOTH, {("a", "z"): 0.5}), "only distributions can be correlated"),
        (lambda: al.expand(product, WITH_BOTH, al.MultiElement()), "expand by MultiElement: 'a' is an al.Interval"),
        (lambda: al.expand(product, WITH_BOTH).at({"a": 3.0}), "expected 'a' from -1 to 2; received 3"),
    ],
)
def test_what_has_no_meaning_is_refused_in_a_sentence(declare, match):
    with pytest.raises(al.ProblemError, match=match):
        declare()
