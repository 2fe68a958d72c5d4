"""Dimensions with limits: their distribution by hand-computed numbers, the forms of a drawing, and refusals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aleator._core.errors import ProblemError
from aleator.uncertainty import Decision, HermiteGerm, Toleranced, named_numbers, placements, realise, toleranced
from compiling import compiled

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
        ("27.645+0.05-0.02", {"nominal": 27.645, "plus": 0.05, "minus": 0.02}),
        ("27.645 +0.05 \N{MINUS SIGN}0.02", {"nominal": 27.645, "plus": 0.05, "minus": 0.02}),
        ("20 -0.007/-0.028", {"nominal": 20.0, "plus": -0.007, "minus": 0.028}),
        ("8 0/-0.1", {"nominal": 8.0, "plus": 0.0, "minus": 0.1}),
        ("27.645 ±0.05", {"nominal": 27.645, "tolerance": 0.05}),
        ("11.43 +/- 0.01", {"nominal": 11.43, "tolerance": 0.01}),
        ("1.5e-3 +/- 1e-5", {"nominal": 1.5e-3, "tolerance": 1e-5}),
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


def test_sharing_keeps_the_side_to_which_the_process_is_shifted():
    distribution = Toleranced(10.0, tolerance=0.3, cp=2.0, cpk=1.5, towards="lower").shared("d")
    assert float(distribution.mean()) == pytest.approx(9.925, rel=1e-14)
