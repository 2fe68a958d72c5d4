"""What is added, compared or shared must be in one unit, where units are known."""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al

UNITS = {
    **{"place": "m", "other_place": "m", "long": "mm", "acceleration": "m/s²", "torque": "N m", "moment": "N·m"},
    **{"energy": "J", "turned": "deg", "angle": "rad", "speed": "m/s", "rate": "m s^-1", "share": "-", "percent": "%"},
    **{"odd": "bananas", "two_ways": "W/m² K", "none": "", "wrong": 3.0, "warm": "°C", "heat": "K"},
}


class Mixed(al.AlgebraicSystem):
    """One number, called by many units; `bare` has none."""

    units: ClassVar[Any] = UNITS
    x: Any = al.parameter("N")
    y: Any = al.parameter("mm")

    def outputs(self):
        return dict.fromkeys((*UNITS, "bare"), self.x + self.y)


def declared(objective=None, constraint=None):
    y = al.Uniform(al.Decision(1.0, 0.5, 2.0), half_width=0.1)
    objective = al.output("bare").mean if objective is None else objective
    return al.Problem(Mixed(x=2.0, y=y), minimize=objective, subject_to=[] if constraint is None else [constraint])


def out(name):
    return al.output(name)


PLACE, ACCELERATION = out("place"), out("acceleration")


@pytest.mark.parametrize(
    ("expression", "words"),
    [
        (PLACE.mean + ACCELERATION.mean, r"'μ\[place\]' is in m and 'μ\[acceleration\]' in m/s², which measure diff"),
        (PLACE.std + al.covariance(PLACE, ACCELERATION), "is in m and .* in m"),
        (
            PLACE.mean + al.value("y.half_width"),
            r"is in m and 'y\.half_width' in mm, which differ in size: 1 mm is 0\.",
        ),
        (al.objectives.norm(PLACE.mean, PLACE.std) + ACCELERATION.mean, "'‖.*‖' is in m and .* in m/s²"),
    ],
)
def test_known_units_that_differ_are_refused_in_one_sentence_that_names_both(expression, words):
    with pytest.raises(al.ProblemError, match=rf"The objective: .*{words}"):
        declared(expression)
    with pytest.raises(al.ProblemError, match=rf"Constraint 'limit': .*{words}") as refused:
        declared(constraint=(expression <= 1.0).named("limit"))
    assert "\n" not in str(refused.value)


def test_comparisons_and_margins_of_another_unit_are_refused():
    for constraint in (PLACE.mean <= ACCELERATION.mean, PLACE.mean + 1.25 * ACCELERATION.std <= 0.034):
        with pytest.raises(al.ProblemError, match=r"Constraint '.*' is in m and .* in m+(/s²)?, which"):
            declared(constraint=constraint)


@pytest.mark.parametrize(
    "expression",
    [
        PLACE.mean + 2 * out("other_place").std + 3.0,
        out("torque").mean + out("moment").std + out("energy").quantile(0.9),
        out("share").mean + PLACE.probability(above=1.0) + PLACE.sobol("y") + out("angle").mean,
        out("warm").mean - out("heat").std,
        # what is not known, or can be read in two ways
        PLACE.mean + out("odd").mean + out("none").mean + out("bare").mean,
        out("heat").mean + out("wrong").mean,
        # factors that bring one unit to the other, or weigh one against the other
        PLACE.mean + 1e-3 * out("long").mean,
        out("angle").mean - np.pi / 180 * out("turned").mean,
        PLACE.mean + 0.1 * ACCELERATION.mean,
        # norms and cost curves are sums that nobody wrote as such
        al.objectives.norm(PLACE.mean, ACCELERATION.mean) + out("energy").mean,
        al.cost.reciprocal("y.half_width", bias=0.0, scale=1.0) + PLACE.mean,
    ],
)
def test_units_that_agree_or_are_not_known_are_not_refused(expression):
    assert declared(expression, expression <= 1e6)


class Moving(al.System):
    states = ("x",)
    units: ClassVar[Any] = {"x": "m", "speed": "m/s", "force": "N", "drive": "W", "energy": "N m"}
    target: Any = al.parameter("m")

    def rhs(self, t, z):
        return (self.target - z.x,)

    def outputs(self, t, z):
        speed = self.target - z.x
        return {"x": z.x, "speed": speed, "force": speed, "drive": speed, "energy": z.x}


def moving(objective):
    target = al.Uniform(1.0, half_width=0.1)
    return al.Problem(Moving(target), grid=al.Grid(al.Decision(1.0, 0.5, 2.0), 4), minimize=objective)


def test_integrals_over_time_have_units_of_their_own():
    assert moving(al.integral("drive").mean + al.terminal("energy").mean)
    assert moving(al.time_integral(al.path("speed").std) + al.terminal("x").mean)
    # The usual compromise of time and effort: weights are one unless others are given.
    effort, power = al.objectives.effort("force"), al.objectives.power({"force": "speed"})
    assert moving(al.objectives.final_time() + effort + power)
    for clash, words in (
        (al.integral("x").mean + al.terminal("x").std, "is in m s and .* in m,"),
        (al.objectives.final_time() + al.terminal("x").mean, "'t_final' is in s and .* in m,"),
        (al.time_integral(al.path("x").mean + al.path("speed").std), r"is in m and .* in m/s,"),
    ):
        with pytest.raises(al.ProblemError, match=words):
            moving(clash)


class Wheels(al.AlgebraicSystem):
    front: Any = al.parameter("mm")
    rear: Any = al.parameter("m")
    axle: Any = al.parameter("mm")

    def outputs(self):
        return {"gap": jnp.asarray(self.front - self.rear + self.axle)}


def test_one_number_shared_by_fields_of_different_units_is_refused():
    radius = al.Normal(300.0, 1.0).shared("radius")
    with pytest.raises(
        al.ProblemError, match=r"'radius' is shared by 'front', in mm, and 'rear', in m, .* 1000 mm: give"
    ):
        al.Problem(Wheels(radius, radius, 1.0), minimize=al.output("gap").mean)
    assert al.Problem(Wheels(radius, 0.3, radius), minimize=al.output("gap").mean)
