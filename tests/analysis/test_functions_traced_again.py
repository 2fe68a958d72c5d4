"""`al.expand` and Monte Carlo trace a function again when its code may have changed, and only then."""

from typing import ClassVar

import equinox as eqx
import jax
import numpy as np
import pytest

import aleator as al
from aleator._core import tracing

GAIN = {"value": 2.0}
INPUT = {"x": al.Uniform.bounds(0.0, 2.0)}


class Line(eqx.Module):
    """A line through a constant of its class, at a power of two."""

    slope: al.Number
    power: int = 1
    OFFSET: ClassVar[float] = 0.0

    def at_two(self):
        return self.OFFSET + self.slope * 2.0**self.power


def expanded(function, model):
    return float(al.expand(function, model, al.Expansion(order=3)).mean)


def sampled(function, model):
    return float(np.mean(al.references.monte_carlo(function, model, 64).values))


@pytest.fixture
def traces(monkeypatch):
    """The names of the functions traced."""
    names, trace = [], tracing.trace

    def told(*arguments, name="", **options):
        names.append(name)
        return trace(*arguments, name=name, **options)

    monkeypatch.setattr(tracing, "trace", told)
    return names


def test_other_numbers_and_decisions_need_no_other_trace(traces):
    for width in (1.0, 2.0):
        model = {"x": al.Uniform.bounds(-width, width), "y": al.Decision(width)}
        assert expanded(lambda m: 3.0 * m["x"] + m["y"], model) == pytest.approx(width, abs=1e-12)
    assert traces.count("'<lambda>'") == 1


def test_a_trace_of_known_numbers_can_be_differentiated():
    def mean(low):
        return al.expand(lambda m: m["x"] ** 2, {"x": al.Uniform.bounds(low, 3.0)}, al.Expansion(order=3)).mean

    assert float(mean(0.0)) == pytest.approx(3.0)
    assert float(jax.grad(mean)(1.0)) == pytest.approx((2 * 1.0 + 3.0) / 3)


@pytest.mark.parametrize("mean", [expanded, sampled])
def test_a_changed_global_is_read(mean, monkeypatch):
    def response(m):
        return GAIN["value"] + 0.0 * m["x"]

    for gain in (2.0, 4.0, 2.0):
        monkeypatch.setitem(GAIN, "value", gain)
        assert mean(response, INPUT) == pytest.approx(gain)


def test_a_changed_attribute_of_a_class_in_the_model_is_read(monkeypatch):
    model = Line(al.Uniform.bounds(0.0, 2.0))
    for offset in (0.0, 5.0, 0.0):
        monkeypatch.setattr(Line, "OFFSET", offset)
        assert expanded(Line.at_two, model) == pytest.approx(2.0 + offset)


def test_whole_numbers_of_the_model_are_part_of_the_equations():
    for power in (1, 3, 1):
        assert expanded(Line.at_two, Line(al.Uniform.bounds(0.0, 2.0), power)) == pytest.approx(2.0**power)


def test_plain_numbers_that_a_function_branches_on_are_part_of_the_equations():
    def response(m):
        return m["x"] * (1.0 if m["sign"].hex()[0] == "-" else 3.0)

    means = [sampled(response, {**INPUT, "sign": sign}) for sign in (0.0, -0.0, 0.0)]
    assert means[0] == means[2] == pytest.approx(3.0 * means[1])


def test_a_function_that_records_its_calls_is_called_at_each_use():
    calls = []

    def response(m):
        calls.append(m["x"])
        return m["x"]

    for _ in range(2):
        before = len(calls)
        assert expanded(response, INPUT) == pytest.approx(1.0)
        assert len(calls) > before
