"""`allocate`: against Lagrange's conditions of a linear stack, and the refusals."""

import numpy as np
import pytest

import aleator as al

SLOPES = {"housing": 0.4, "plate": 0.05, "shim": 0.02}
FIXED = 1.0


def stack(**dimensions):
    drawn = {"housing": "40.0 ±0.1", "plate": "13.0 ±0.1", "shim": "0.6 ±0.05"}
    return al.Assembly({name: al.toleranced(text) for name, text in drawn.items()} | dimensions, features=FEATURES)


FEATURES = {"gap": "housing - 3*plate - shim"}
COSTS = {name: (FIXED, slope) for name, slope in SLOPES.items()}


@pytest.mark.slow
def test_half_widths_of_a_linear_stack_are_those_of_lagrange():
    """Costs `a + b / h` under a limit on `sum (s h)²` or on `sum |s| h`."""
    found = al.allocate(stack(), COSTS, "gap", lower=0.1, upper=0.7, cpk=1.2)
    sensitivities, slopes = np.array([1.0, 3.0, 1.0]), np.array(list(SLOPES.values()))
    statistical = np.cbrt(slopes / sensitivities**2)
    statistical *= 0.3 / 1.2 / np.linalg.norm(sensitivities * statistical)
    worst = np.sqrt(slopes / sensitivities)
    worst *= 0.3 / np.sum(sensitivities * worst)
    assert not found.failed
    for tolerances, widths in ((found.statistical, statistical), (found.worst_case, worst)):
        minus, plus = np.array(list(tolerances.zones.values())).T
        np.testing.assert_allclose(plus, widths, rtol=1e-5)
        np.testing.assert_allclose(minus, widths, rtol=1e-5)
        assert tolerances.cost == pytest.approx(3 * FIXED + np.sum(slopes / widths), rel=1e-6)
    assert found.statistical.analysis.cpk == pytest.approx(1.2, rel=1e-6)
    assert found.worst_case.analysis.worst_case == pytest.approx((0.1, 0.7), abs=1e-6)
    assert found.today.cost == pytest.approx(3 * FIXED + 0.4 / 0.1 + 0.05 / 0.1 + 0.02 / 0.05)
    lines = str(found).splitlines()
    assert lines[0].split() == ["gap,", "0.1", "to", "0.7", "today", "statistical,", "Cpk", "1.2", "worst", "case"]
    assert lines[1].split()[:3] == ["housing", "±", "0.1"]


class Sum(al.AlgebraicSystem):
    """Two parts under a factor, and a third one."""

    a: al.Number
    b: al.Number
    c: al.Number
    factor: al.Number

    def outputs(self):
        return {"length": self.factor * (self.a + self.b) + self.c}


@pytest.mark.slow
def test_correlations_other_distributions_and_decided_numbers_of_a_stack_count():
    parts = {name: al.Toleranced(middle, tolerance=0.1) for name, middle in (("a", 2.0), ("b", 3.0))}
    correlated = al.correlated(parts, {("a", "b"): 0.8})
    model = Sum(**correlated, c=al.Normal(0.0, 0.01), factor=al.Decision(1.3, 0.5, 2.0))
    found = al.allocate(model, {"a": (0.0, 0.1), "b": (0.0, 0.1)}, "length", lower=4.8, upper=5.2)
    # Both limits are active where the factor centres the length: 9 var = 2 (1 + 0.8) w² + (3 0.01)², and 2 w + 3 0.01.
    for tolerances, width in ((found.statistical, np.sqrt((0.2**2 - 0.03**2) / 3.6)), (found.worst_case, 0.085)):
        assert tolerances.decisions["factor"] == pytest.approx(1.0, abs=1e-6)
        for name in parts:
            assert tolerances.zones[name] == pytest.approx((width, width), rel=1e-5)
    assert found.statistical.analysis.cpk == pytest.approx(1.0, rel=1e-5)
    assert found.worst_case.analysis.worst_case == pytest.approx((4.8, 5.2), abs=1e-5)
    assert ["factor", "1.3", "1", "1"] in [line.split() for line in str(found).splitlines()]


@pytest.mark.slow
@pytest.mark.parametrize("costs", [{"b": (1.0, 0.04)}, {"a": (1.0, 0.04), "b": (1.0, 0.04)}])
def test_a_nominal_value_may_be_decided_with_the_tolerances(costs):
    """The gap of two parts is centred between its limits, 0.2 on either side."""
    parts = {"a": al.Toleranced(al.Decision(10.0, 9.5, 10.5), tolerance=0.1), "b": al.Toleranced(10.2, tolerance=0.1)}
    found = al.allocate(al.Assembly(parts, features={"gap": "b - a"}), costs, "gap", lower=0.05, upper=0.45)
    other = 0.1 if len(costs) == 1 else 0.2 / np.sqrt(2)
    for tolerances, width in ((found.statistical, np.sqrt(0.2**2 - other**2)), (found.worst_case, 0.1)):
        assert tolerances.decisions["a.nominal"] == pytest.approx(9.95, abs=1e-6)
        assert tolerances.zones["b"] == pytest.approx((width, width), rel=1e-5)


@pytest.mark.slow
def test_one_sided_zones_grow_from_their_nominal_side_and_others_about_their_middle():
    one_sided = stack(plate=al.toleranced("13.0 +0.1/-0", cp=1.33), shim=al.toleranced("0.6 -0.01/-0.05"))
    found = al.allocate(one_sided, COSTS | {"housing": (1.0, 0.1)}, "gap", lower=-1.0, upper=0.6).worst_case
    assert found.zones["plate"][0] == 0.0
    assert found.zones["shim"][1] == pytest.approx(-0.01)
    minus, plus = found.zones["housing"]
    # From 0.4 up to 0.6: the housing's plus and the shim's minus; down to -1: the others.
    assert plus + found.zones["shim"][0] == pytest.approx(0.2, abs=1e-6)
    assert 3 * found.zones["plate"][1] + minus - 0.01 == pytest.approx(1.4, abs=1e-6)


@pytest.mark.slow
def test_what_no_tolerances_can_keep_is_said_and_the_rest_is_given():
    found = al.allocate(stack(), {"shim": (0.0, 0.1)}, "gap", lower=0.1, upper=0.7, cpk=0.5)
    assert found.statistical is not None
    assert found.worst_case is None
    assert "no design was found that meets all of these, whatever it costs: gap" in found.failed["worst case"]
    assert "worst case: " in str(found).splitlines()[-1]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"costs": {"bolt": (1.0, 1.0)}}, r"costs: expected .* received \{'bolt'"),
        ({"costs": {"shim": (1.0, -1.0)}}, r"costs of 'shim': expected .*slope above 0; received \(1.0, -1.0\)"),
        ({"lower": 1.0, "upper": 0.5}, r"expected limits lower < upper.*received 1.0 and 0.5"),
        ({"upper": np.inf, "lower": -np.inf}, "one of them finite"),
        ({"stack": stack(shim=al.Normal(0.6, 0.01))}, r"'shim': expected an al.Toleranced dimension"),
        ({"stack": stack(more=al.Normal(al.Decision(1.0), 0.1))}, r"'more': expected an al.Toleranced dimension where"),
    ],
)
def test_is_refused(options, words):
    given = {"stack": stack(), "costs": COSTS, "output": "gap", "lower": 0.1, "upper": 0.7} | options
    with pytest.raises(al.ProblemError, match=words):
        al.allocate(given.pop("stack"), given.pop("costs"), given.pop("output"), **given)
