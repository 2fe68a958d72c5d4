"""Numbers declared positive: everything that can reach zero is refused, everything that cannot is let through."""

from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
import pytest

from aleator._core.errors import ProblemError
from aleator.uncertainty import (
    Beta,
    Decision,
    Gamma,
    LogNormal,
    Normal,
    Sample,
    TruncatedNormal,
    Uniform,
    at_means,
    fields_of,
    parameter,
    refuse_nonpositive,
)


class Mass(eqx.Module):
    m: Any = parameter("kg", positive=True)
    offset: Any = parameter("m", default=0.0)


class Holder(eqx.Module):
    inside: Any
    count: int = eqx.field(static=True, default=0)


class Whole(NamedTuple):
    system: Any
    inputs: Any


REACH_ZERO = {
    "zero": 0.0,
    "array": np.array([1.0, 0.0]),
    "normal": Normal(10.0, 0.001),
    "uniform that touches zero": Uniform(1.0, half_width=1.0),
    "decision": Decision(1.0, 0.0, 2.0),
    "decided both": Uniform(Decision(3.0, 2.0, 5.0), half_width=Decision(1.0, 0.5, 2.0)),
    "beta with decided lower end": Beta(mean=1.5, std=0.1, lower=Decision(1.0, 0.0, 1.2), upper=2.0),
    "lognormal": LogNormal(mean=1.0, std=0.5, lower=-0.1),
    "truncated normal with decided end": TruncatedNormal(1.0, 0.5, lower=Decision(0.1, 0.0, 0.2)),
    "sample": Sample([1.0, 2.0], location=Decision(0.0, -2.0, 0.0)),
    "held at its mean": at_means(Uniform(1.0, half_width=2.0)),
}
STAY_POSITIVE = {
    "array": np.array([1.0, 0.1]),
    "beta whose decided spread may nearly vanish": Beta(
        mean=0.5, std=Decision(0.1, 1e-6, 0.2), lower=Decision(0.1, 0.1, 0.2), upper=1.0
    ),
    "gamma whose decided spread may nearly vanish": Gamma(mean=2.0, std=Decision(0.1, 1e-6, 0.2), lower=0.1),
    "decided uniform": Uniform(Decision(3.0, 2.0, 5.0), half_width=Decision(1.0, 0.5, 1.999)),
    "no numbers": np.zeros(0),
    "a function": abs,
    "lognormal": LogNormal(mean=Decision(1.0, 0.5, 2.0), std=0.5),
}


def test_what_can_reach_zero_is_refused_by_name():
    for value in REACH_ZERO.values():
        with pytest.raises(ProblemError, match="'m' must stay positive"):
            refuse_nonpositive(Mass(value))


def test_what_stays_positive_is_let_through_and_other_fields_may_be_anything():
    for value in STAY_POSITIVE.values():
        refuse_nonpositive(Mass(value, offset=Normal(-5.0, 3.0)))


def test_positive_fields_are_found_anywhere_in_a_model_and_the_lowest_value_is_told():
    for model, message in [
        ([Mass(1.0), Mass(Uniform(1.0, half_width=1.5))], r"^'1.m' must stay .*half_width=1.5\) can reach -0.5"),
        (Holder({"a": (Mass(Normal(1e6, 1.0)),)}), r"^'inside.a.0.m' must stay .*unbounded below\. Reduce its spread"),
        (Whole(Mass("heavy"), {}), "^'system.m' must stay .*expected a number.*received str 'heavy'"),
    ]:
        with pytest.raises(ProblemError, match=message):
            refuse_nonpositive(model)


def test_units_are_found_with_the_fields():
    units = {name: field.metadata.get("unit") for name, field, _ in fields_of(Holder(Mass(1.0)))}
    assert units == {"inside": None, "count": None, "inside.m": "kg", "inside.offset": "m"}
