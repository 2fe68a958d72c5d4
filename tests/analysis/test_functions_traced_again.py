"""`al.expand` traces a function again when its code may have changed, and only then."""

import pytest

import aleator as al
from aleator._core import tracing

GAIN = {"value": 2.0}
INPUT = {"x": al.Uniform.bounds(0.0, 2.0)}


def expanded(function, model):
    return float(al.expand(function, model, al.Expansion(order=3)).mean)


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


def test_a_changed_global_is_read(monkeypatch):
    def response(m):
        return GAIN["value"] + 0.0 * m["x"]

    for gain in (2.0, 4.0, 2.0):
        monkeypatch.setitem(GAIN, "value", gain)
        assert expanded(response, INPUT) == pytest.approx(gain)


def test_whole_numbers_of_the_model_are_part_of_the_equations():
    for power in (1, 3, 1):
        assert expanded(lambda m: m["x"] * 2.0 ** m["power"], {**INPUT, "power": power}) == pytest.approx(2.0**power)


def test_plain_numbers_that_a_function_branches_on_are_part_of_the_equations():
    def response(m):
        return m["x"] * (1.0 if m["sign"].hex()[0] == "-" else 3.0)

    means = [expanded(response, {**INPUT, "sign": sign}) for sign in (0.0, -0.0, 0.0)]
    assert means[0] == means[2] == pytest.approx(3.0 * means[1])
