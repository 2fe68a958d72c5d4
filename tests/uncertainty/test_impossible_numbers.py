"""What is refused as a number, a distribution, a decision or a dimension, and why: by one table for each subject."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator._core.errors import ProblemError
from aleator.uncertainty import (
    Decision,
    HermiteGerm,
    Toleranced,
    at_means,
    fields_of,
    named_numbers,
    placements,
    realise,
    refuse_nonpositive,
    toleranced,
)
from compiling import compiled


def bell(x):
    return 7.0 * np.exp(-(x**2) / 2)


POSITIVE_NUMBERS = {
    "Uniform half_width": lambda s: al.Uniform(1.0, half_width=s),
    "Beta std": lambda s: al.Beta(mean=0.3, std=s),
    "Beta alpha": lambda s: al.Beta(alpha=s, beta=2.0),
    "Gamma shape": lambda s: al.Gamma(shape=s, scale=2.0),
    "Exponential rate": lambda s: al.Exponential(rate=s),
    "LogNormal std": lambda s: al.LogNormal(mean=1.0, std=s),
    "Weibull shape": lambda s: al.Weibull(1.0, s),
    "TruncatedNormal scale": lambda s: al.TruncatedNormal(1.0, s, lower=0.0),
    "Density scale": lambda s: al.Density(bell, -1.0, 1.0, scale=s),
}


def test_a_spread_or_shape_that_is_not_positive_and_finite_is_refused_by_name_and_value():
    for name, make in POSITIVE_NUMBERS.items():
        family, parameter = name.split()
        for bad in (0.0, -1.0, np.nan, np.inf):
            with pytest.raises(ProblemError, match=f"^{family} needs .*{parameter}={bad:g}"):
                make(bad)


IMPOSSIBLE = [
    (lambda: al.Beta(mean=0.3, std=0.46), "std=0.46"),  # at most sqrt(mean (1 - mean)), here 0.458
    (lambda: al.Exponential(mean=1.0, lower=2.0), "finite mean above lower.*lower=2"),
    (lambda: al.TruncatedNormal(0.0, 1.0, lower=40.0), "within 37 scales.*lower=40"),
    (lambda: al.Density(np.sin, 0.0, 7.0), "not negative.*received -"),
    (lambda: al.Density(lambda x: (1 - x) ** -0.5, 0.0, 1.0), "grows without bound towards its end 1.*location"),
    (lambda: al.Density(lambda x: 1 / (1 + x**2), -np.inf, np.inf), "moments"),
    (lambda: al.Decision(1.0, lower=2.0, upper=0.0), "received 2.0 <= 1.0 <= 0.0"),
    (lambda: al.Toleranced(1.0, plus=0.1, minus=-0.1), "in order.*minus=-0.1"),
]


@pytest.mark.parametrize(("make", "received"), IMPOSSIBLE)
def test_numbers_that_cannot_be_are_refused_with_what_was_received(make, received):
    with pytest.raises(ProblemError, match=received):
        make()


NARROW, FINITE = "Narrow the bounds of its decisions", "Give the decision finite bounds"
INSIDE_OUT = {
    "gamma below its bound": (lambda: al.Gamma(mean=al.Decision(2, -3, 5), std=1), "mean=-3", NARROW),
    "normal of unbounded std": (lambda: al.Normal(1.0, al.Decision(0.1)), "std=-inf", FINITE),
    "beta wider than possible": (lambda: al.Beta(mean=al.Decision(0.5, 0.1, 0.9), std=0.4), "mean=0.1", NARROW),
}


@pytest.mark.parametrize(("make", "corner", "remedy"), INSIDE_OUT.values(), ids=INSIDE_OUT.keys())
def test_a_distribution_that_its_decisions_turn_inside_out_is_refused_with_the_corner_and_the_remedy(
    make, corner, remedy
):
    with pytest.raises(ProblemError, match=f"its decisions reach {corner}, where it is no distribution.*{remedy}"):
        make()


def test_a_spread_may_vanish_or_grow_without_bound_where_every_decision_in_between_makes_a_distribution():
    al.Normal(al.Decision(0), al.Decision(1, 0))
    al.Uniform.bounds(al.Decision(1, -np.inf, 2), al.Decision(3, 2, np.inf))
    al.Beta(alpha=2, beta=2, lower=al.Decision(0, 0, 1), upper=1)
    al.Gamma(shape=2, scale=al.Decision(1, 0), lower=al.Decision(0))
    al.Beta(mean=al.Decision(0.5, 0.2, 0.8), std=al.Decision(0.1, 0.01, 0.3))


# --- Numbers declared positive ----------------------------------------------------------------------------------------


class Mass(eqx.Module):
    m: Any = al.parameter("kg", positive=True)
    offset: Any = al.parameter("m", default=0.0)


class Holder(eqx.Module):
    inside: Any
    count: int = eqx.field(static=True, default=0)


class Whole(NamedTuple):
    system: Any
    inputs: Any


REACH_ZERO = {
    "zero": 0.0,
    "array": np.array([1.0, 0.0]),
    "normal": al.Normal(10.0, 0.001),
    "uniform that touches zero": al.Uniform(1.0, half_width=1.0),
    "decision": al.Decision(1.0, 0.0, 2.0),
    "beta with decided lower end": al.Beta(mean=1.5, std=0.1, lower=al.Decision(1.0, 0.0, 1.2), upper=2.0),
    "lognormal": al.LogNormal(mean=1.0, std=0.5, lower=-0.1),
    "sample": al.Sample([1.0, 2.0], location=al.Decision(0.0, -2.0, 0.0)),
    "held at its mean": at_means(al.Uniform(1.0, half_width=2.0)),
}
STAY_POSITIVE = {
    "array": np.array([1.0, 0.1]),
    "beta whose decided spread may nearly vanish": al.Beta(
        mean=0.5, std=al.Decision(0.1, 1e-6, 0.2), lower=al.Decision(0.1, 0.1, 0.2), upper=1.0
    ),
    "decided uniform": al.Uniform(al.Decision(3.0, 2.0, 5.0), half_width=al.Decision(1.0, 0.5, 1.999)),
    "no numbers": np.zeros(0),
    "a function": abs,
    "lognormal": al.LogNormal(mean=al.Decision(1.0, 0.5, 2.0), std=0.5),
}


def test_a_number_declared_positive_is_so_in_expansions_and_samples_too():
    for verb in (al.expand, al.references.monte_carlo, al.references.linearise):
        with pytest.raises(al.ProblemError, match="'m' must stay positive, but Normal"):
            verb(lambda one: one.m, Mass(al.Normal(1.0, 1.0)))
    with pytest.raises(al.ProblemError, match="'m' must stay positive, but Normal"):
        al.foreign.ask(Mass(al.Normal(1.0, 1.0)))


def test_what_can_reach_zero_is_refused_by_name():
    for value in REACH_ZERO.values():
        with pytest.raises(ProblemError, match="'m' must stay positive"):
            refuse_nonpositive(Mass(value))


def test_what_stays_positive_is_let_through_and_other_fields_may_be_anything():
    for value in STAY_POSITIVE.values():
        refuse_nonpositive(Mass(value, offset=al.Normal(-5.0, 3.0)))


def test_positive_fields_are_found_anywhere_in_a_model_and_the_lowest_value_is_told():
    for model, message in [
        ([Mass(1.0), Mass(al.Uniform(1.0, half_width=1.5))], r"^'1.m' must stay .*half_width=1.5\) can reach -0.5"),
        (
            Holder({"a": (Mass(al.Normal(1e6, 1.0)),)}),
            r"^'inside.a.0.m' must stay .* below\. Write TruncatedNormal\(location=1000000, scale=1, lower=999994\)",
        ),
        ([Mass(al.Normal(3.0, 1.0))], r"Write LogNormal\(mean=3, std=1\), which has the same mean"),
        ([Mass(al.Normal(al.Decision(3.0, 1.0, 5.0), 1.0))], "Raise its lower bound, or those of the decisions in it"),
        (Whole(Mass("heavy"), {}), "^'system.m' must stay .*expected a number.*received str 'heavy'"),
    ]:
        with pytest.raises(ProblemError, match=message):
            refuse_nonpositive(model)


def test_units_are_found_with_the_fields():
    units = {name: field.metadata.get("unit") for name, field, _ in fields_of(Holder(Mass(1.0)))}
    assert units == {"inside": None, "count": None, "inside.m": "kg", "inside.offset": "m"}


# --- Dimensions with limits -------------------------------------------------------------------------------------------


# distribution, mean, standard deviation, limits
CASES = {
    "clutch hub": (Toleranced(27.645, tolerance=0.05), 27.645, 0.05 / 3, (27.595, 27.695)),
    "by capability": (Toleranced(27.645, tolerance=0.05, cp=1.25), 27.645, 0.1 / 7.5, (27.595, 27.695)),
    "by sigma level": (Toleranced(27.645, tolerance=0.05, sigmas=6), 27.645, 0.05 / 6, (27.595, 27.695)),
    "asymmetric": (Toleranced(27.645, plus=0.05, minus=0.02), 27.66, 0.07 / 6, (27.625, 27.695)),
    "off centre, low": (
        Toleranced(10.0, plus=0.4, minus=0.2, cp=2.0, cpk=1.5, towards="lower"),
        10.025,
        0.05,
        (9.8, 10.4),
    ),
    "outside its zone": (Toleranced(10.0, tolerance=0.3, cp=1.0, cpk=-1.0), 10.6, 0.1, (9.7, 10.3)),
}


def test_mean_spread_limits_and_capability_are_those_computed_by_hand():
    germs = np.array([-3.0, -0.5, 2.3])
    program = compiled(lambda: [jax.vmap(one.value)(jnp.asarray(germs)) for one, *_ in CASES.values()])
    for (distribution, mean, std, limits), values in zip(CASES.values(), program(), strict=True):
        assert float(distribution.mean()) == pytest.approx(mean, rel=1e-14)
        assert float(distribution.std()) == pytest.approx(std, rel=1e-12)
        assert tuple(map(float, distribution.limits())) == pytest.approx(limits, rel=1e-14)
        assert distribution.germ() == HermiteGerm()
        assert distribution.support() == (-np.inf, np.inf)
        assert np.asarray(values) == pytest.approx(mean + std * germs, rel=1e-13)
        # cpk is the distance to the nearer limit in three standard deviations.
        capability = distribution.parameters.get("cp", distribution.parameters.get("sigmas", 3.0) / 3)
        cpk = min(limits[1] - mean, mean - limits[0]) / (3 * std)
        assert cpk == pytest.approx(distribution.parameters.get("cpk", capability), rel=1e-10)


@pytest.mark.parametrize(
    ("text", "parameters"),
    [
        ("27.645 +0.05/-0.02", {"nominal": 27.645, "plus": 0.05, "minus": 0.02}),
        ("27.645 -0.02/+0.05", {"nominal": 27.645, "plus": 0.05, "minus": 0.02}),
        ("27.645 +0.05 \N{MINUS SIGN}0.02", {"nominal": 27.645, "plus": 0.05, "minus": 0.02}),
        ("20 -0.007/-0.028", {"nominal": 20.0, "plus": -0.007, "minus": 0.028}),
        ("27.645 ±0.05", {"nominal": 27.645, "tolerance": 0.05}),
        ("11.43 +/- 0.01", {"nominal": 11.43, "tolerance": 0.01}),
    ],
)
def test_a_drawings_text_is_read_in_its_usual_forms(text, parameters):
    distribution = toleranced(text, cp=1.33)
    assert distribution.parameters == pytest.approx(parameters | {"cp": 1.33}, rel=1e-15)
    assert toleranced(text).parameters["cp"] == 1.0
    with pytest.raises(ProblemError, match="without a unit"):
        toleranced(f"{text} V")


def test_a_decided_tolerance_is_a_number_of_the_model_and_sets_the_spread():
    model = {"a": Toleranced(27.645, tolerance=Decision(0.05, 0.005, 0.2), cp=1.25), "c": toleranced("11.43 ±0.01")}
    places = placements(model)
    assert tuple(places.decisions) == ("a.tolerance",)
    numbers = named_numbers(model, jnp.array([0.1]))
    assert float(numbers["a.tolerance"]) == 0.1
    assert float(numbers["a.std"]) == pytest.approx(0.1 / 3.75, rel=1e-13)
    real = realise(model, jnp.array([1.5, -1.0]), jnp.array([0.1]))
    assert float(real["a"]) == pytest.approx(27.645 + 1.5 * 0.1 / 3.75, rel=1e-14)
    assert float(real["c"]) == pytest.approx(11.43 - 0.01 / 3, rel=1e-14)
