"""Units of functionals, statistics and expressions, by dimensional analysis on paper."""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.reporting._numbers import unit_of_decision, unit_of_expression, units_of_moments
from aleator.statistics._units import integrated, product, rate, squared

ENDS = {"start": ((0.0, 0.0), 0), "end": ((1.0, 1.0), 0)}


class Crane(al.Mechanical):
    """A trolley and a winch: one joint that slides and one that turns; `temperature` has no unit."""

    names = ("x", "q")
    units: ClassVar = {
        **{"x": "m", "x_rate": "m/s", "x_torque": "N", "q": "rad", "q_rate": "rad/s", "q_torque": "N m"},
        **{"drive": "W", "stored": "J", "jerk": "m/s³", "share": "-"},
    }
    mass: al.Number = al.parameter("kg", positive=True)

    def mass_matrix(self, q: Any) -> Any:
        return self.mass * jnp.eye(2)

    def coriolis(self, q: Any, v: Any) -> Any:
        return jnp.zeros((2, 2))

    def outputs(self, motion: Any) -> dict[str, Any]:
        one = motion.q[0]
        return dict.fromkeys(("drive", "stored", "jerk", "share", "temperature"), one)


@pytest.fixture(scope="module")
def crane() -> al.Problem:
    objective = al.objectives.effort("x_torque") + al.objectives.power({"q_torque": "q_rate"})
    motion = al.BSpline(al.Decision(np.full((4, 2), 0.5), -5.0, 5.0), **ENDS)
    mass = al.Gamma(shape=al.Decision(4.0, 3.0, 5.0), scale=al.Decision(0.5, 0.1, 1.0), lower=0.1)
    grid = al.Grid(al.Decision(2.0, 1.0, 3.0), 4)
    return al.Problem(al.InverseDynamics(Crane(mass=mass), motion=motion), grid=grid, minimize=objective)


X, Q = al.path("x_torque"), al.path("q_torque")


UNITS = [
    (al.objectives.effort("x_torque"), "N² s"),
    (al.objectives.power({"q_torque": "q_rate", "x_torque": "x_rate"}), "J"),
    (al.objectives.power({"q_torque": "x_rate"}), "N m (m/s) s"),
    (al.objectives.coefficient_power({"q_torque": "q_rate"}), "J"),
    (al.objectives.torque_rate("x_torque"), "(N/s)² s"),
    (al.path("q_torque_rate").std, "N m/s"),
    (al.objectives.terminal_variance("x"), "m²"),
    (al.objectives.terminal_variance("x", "x_rate"), ""),
    (al.objectives.terminal_mean_error({"x": 1.0}), "m"),
    (al.objectives.final_time(), "s"),
    (al.objectives.effort("x_torque") + al.objectives.final_time(), ""),
    (al.objectives.effort("x_torque") + 0 * al.objectives.final_time(), "N² s"),
    (al.time_integral(X.std), "N s"),
    (al.time_integral(al.correlation(X, Q)), "s"),
    (al.time_integral(al.covariance(X, al.path("x_rate"))), "J"),
    (al.rms("x_torque").mean + 2 * al.rms("x_torque").std - 1.0, "N"),
    (al.peak("x_rate").quantile(0.9), "m/s"),
    (al.integral("drive").mean, "J"),
    (al.integral("share").mean, "s"),
    (al.integral("temperature").mean, ""),
    (al.objectives.power({"x_torque": "temperature"}), ""),
    (al.value("mass.mean"), "kg"),
    (al.value("mass.scale") + al.value("mass.std"), "kg"),
    (al.terminal("x").mean + al.cost.reciprocal("mass.std", bias=0.0, scale=1.0), ""),
]


def test_units_follow_from_those_of_outputs(crane):
    assert {str(one): unit_of_expression(one, crane) for one, _ in UNITS} == {str(one): unit for one, unit in UNITS}


def test_functionals_and_decisions_have_their_units(crane):
    assert units_of_moments(crane) == {"∫x_torque² dt": "N² s", "∫|q_torque q_rate| dt": "J"}
    found = {name: unit_of_decision(name, crane) for name in crane.placements.decisions}
    assert found == {"mass.shape": "", "mass.scale": "kg", "motion.free": "", "t_final": "s"}


def test_integrals_and_rates_over_time_are_inverse_where_both_are_simple_and_what_divides_is_set_in_brackets():
    for unit, integral in (("-", "s"), ("", ""), ("W", "J"), ("m/s", "m"), ("rad/s²", "rad/s"), ("N m/s", "N m")):
        assert integrated(unit) == integral
        assert rate(integral) == unit or unit == "-"
    assert product("N/m", "m") == "(N/m) m"
    assert (integrated("kg/m³"), integrated("1/s")) == ("(kg/m³) s", "-")
    assert (squared("m/s²"), squared("-")) == ("(m/s²)²", "-")
    assert rate("N s/m") == "(N s/m)/s"
