"""Numbers declared positive: everything that can reach zero is refused, everything that cannot is let through."""

from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
import pytest

import aleator as al
from aleator._core.errors import ProblemError
from aleator.uncertainty import at_means, fields_of, refuse_nonpositive


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
    "decided both": al.Uniform(al.Decision(3.0, 2.0, 5.0), half_width=al.Decision(1.0, 0.5, 2.0)),
    "beta with decided lower end": al.Beta(mean=1.5, std=0.1, lower=al.Decision(1.0, 0.0, 1.2), upper=2.0),
    "lognormal": al.LogNormal(mean=1.0, std=0.5, lower=-0.1),
    "truncated normal with decided end": al.TruncatedNormal(1.0, 0.5, lower=al.Decision(0.1, 0.0, 0.2)),
    "sample": al.Sample([1.0, 2.0], location=al.Decision(0.0, -2.0, 0.0)),
    "held at its mean": at_means(al.Uniform(1.0, half_width=2.0)),
}
STAY_POSITIVE = {
    "array": np.array([1.0, 0.1]),
    "beta whose decided spread may nearly vanish": al.Beta(
        mean=0.5, std=al.Decision(0.1, 1e-6, 0.2), lower=al.Decision(0.1, 0.1, 0.2), upper=1.0
    ),
    "gamma whose decided spread may nearly vanish": al.Gamma(mean=2.0, std=al.Decision(0.1, 1e-6, 0.2), lower=0.1),
    "decided uniform": al.Uniform(al.Decision(3.0, 2.0, 5.0), half_width=al.Decision(1.0, 0.5, 1.999)),
    "no numbers": np.zeros(0),
    "a function": abs,
    "lognormal": al.LogNormal(mean=al.Decision(1.0, 0.5, 2.0), std=0.5),
}


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
        (
            [Mass(al.TruncatedNormal(22e3, 1500.0, upper=23e3))],
            r"Write TruncatedNormal\(location=22000, scale=1500, lower=13000, upper=23000\)",
        ),
        ([Mass(al.Normal(3.0, 1.0))], r"Write LogNormal\(mean=3, std=1\), which has the same mean"),
        ([Mass(al.Normal(-3.0, 1.0))], "Give a distribution above zero"),
        ([Mass(al.Normal(al.Decision(3.0, 1.0, 5.0), 1.0))], "Raise its lower bound, or those of the decisions in it"),
        (Whole(Mass("heavy"), {}), "^'system.m' must stay .*expected a number.*received str 'heavy'"),
    ]:
        with pytest.raises(ProblemError, match=message):
            refuse_nonpositive(model)


def test_units_are_found_with_the_fields():
    units = {name: field.metadata.get("unit") for name, field, _ in fields_of(Holder(Mass(1.0)))}
    assert units == {"inside": None, "count": None, "inside.m": "kg", "inside.offset": "m"}
