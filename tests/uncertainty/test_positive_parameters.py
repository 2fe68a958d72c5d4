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


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (Uniform(1.0, half_width=1.5), r"Uniform\(mean=1, half_width=1.5\) can reach -0.5"),
        (Uniform(3.0, half_width=Decision(1.0, 0.0)), r"but .* is unbounded below\. Reduce its spread"),
        ("heavy", "expected a number.*received str 'heavy'"),
    ],
)
def test_the_refusal_names_what_it_found_and_its_lowest_value(value, message):
    with pytest.raises(ProblemError, match="'m' must stay positive.*" + message):
        refuse_nonpositive(Mass(value))


@pytest.mark.parametrize(
    ("model", "name"),
    [
        (Holder([Mass(1.0), Mass(0.0)]), "inside.1.m"),
        (Holder({"a": (Mass(0.0),)}), "inside.a.0.m"),
        (Whole(Mass(0.0), {}), "system.m"),
    ],
    ids=["list", "dict and tuple", "a field called system"],
)
def test_positive_fields_are_found_anywhere_in_a_model(model, name):
    with pytest.raises(ProblemError, match=f"^'{name}' must stay positive"):
        refuse_nonpositive(model)


def test_units_are_found_with_the_fields():
    units = {name: field.metadata.get("unit") for name, field, _ in fields_of(Holder(Mass(1.0)))}
    assert units == {"inside": None, "count": None, "inside.m": "kg", "inside.offset": "m"}
