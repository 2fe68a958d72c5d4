"""Controls whose values on the mesh are decisions: what they are as functions of time, and optima that are known."""

from dataclasses import replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.design import history
from aleator.transcription import transcribe
from compiling import compiled
from zoo import Launched, Pendulum, cases

LEVELS, VALUES = np.array([1.0, -2.0, 0.5, 3.0]), np.array([0.0, 2.0, -1.0, 1.0, 0.5])
WAYS = {
    "shooting": al.Sequential(),
    "collocation": al.Simultaneous(),
}
each_way = pytest.mark.parametrize(
    "way", [pytest.param(way, marks=[pytest.mark.slow] * (i > 0)) for i, way in enumerate(WAYS.values())], ids=WAYS
)


class Lag(al.System):
    """`x' = (u - x) / τ` from zero."""

    states = ("x",)
    lag: al.Number = 1.0

    def rhs(self, t, z, u):
        return ((u - z.x) / self.lag,)

    def outputs(self, t, z, u):
        return {"x": z.x, "u": u, "u²": u**2}


def lag(control: Any, integrator: Any = None, **options: Any) -> al.Problem:
    defaults: dict[str, Any] = {"grid": al.Grid(2.0, 4), "minimize": al.terminal("x").mean}
    return al.Problem(Lag(), inputs={"u": control}, integrator=integrator, **(defaults | options))


# --- What it is as a function of time --------------------------------------------------------------------------------


@np.vectorize
def stepped(t: float) -> float:
    """`x` of the lag in closed form, where `u` is constant over each half of a second."""
    x, at = 0.0, 0.0
    for level in LEVELS:
        x, at = level + (x - level) * np.exp(-min(0.5, max(t - at, 0.0))), at + 0.5
    return x


FOURTH = al.integrators.RungeKutta4()
METHODS = {4: FOURTH, 5: FOURTH.reference()}


@cache
def histories() -> dict[Any, Any]:
    """Of the lag by each method on several grids, of a linear control, and of a mechanical system: by one program."""
    held, linear = lag(al.Control(LEVELS)), lag(al.Control(VALUES, degree=1))
    force = {"angle_torque": al.Control(LEVELS)}
    rail = al.ForwardDynamics(Pendulum(gravity=0.0), torque=force)
    problems = {(order, n): held.on_grid(al.Grid(2.0, n), METHODS[order]) for order in METHODS for n in (7, 8, 16)}
    problems["linear"] = linear.on_grid(al.Grid(2.0, 40))
    problems["torque"] = al.Problem(rail, grid=al.Grid(2.0, 4), minimize=al.terminal("angle_rate").mean)

    @compiled
    def run(levels, values):
        vectors = {name: values if name == "linear" else levels for name in problems}
        return [history(one, jnp.zeros(0), vectors[name]) for name, one in problems.items()]

    return dict(zip(problems, jax.tree.map(np.asarray, run(LEVELS, VALUES)), strict=True))


@pytest.mark.parametrize("order", cases([5, 4], 1))
def test_no_order_is_lost_where_a_control_jumps(order):
    errors = [np.abs(histories()[order, n]["x"] - stepped(np.linspace(0.0, 2.0, n + 1))).max() for n in (8, 16)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.35)


def test_on_another_grid_it_is_the_same_function_of_time():
    found, times = histories()[4, 7], np.linspace(0.0, 2.0, 8)
    assert found["x"] == pytest.approx(stepped(times), abs=2e-3)
    assert found["u"] == pytest.approx(LEVELS[np.minimum((2 * times + 1e-9).astype(int), 3)])


def test_a_linear_control_passes_through_its_values_and_forces_of_mechanical_systems_may_jump():
    passed = np.interp(np.linspace(0.0, 2.0, 41), np.linspace(0.0, 2.0, 5), VALUES)
    assert histories()["linear"]["u"] == pytest.approx(passed)
    assert histories()["torque"]["angle_rate"] == pytest.approx(np.append(0.0, 0.5 * np.cumsum(LEVELS)))


@each_way
def test_integrals_over_jumps_are_those_of_each_step_of_its_own(way):
    program = transcribe(lag(al.Control(LEVELS), minimize=al.integral("u²").mean), way).program
    assert program.evaluate(program.start).objective == pytest.approx(0.5 * float(LEVELS @ LEVELS), rel=1e-12)


def test_a_function_is_a_start():
    constant, linear = (al.Control(lambda s: 10 * s, degree=degree) for degree in (0, 1))
    assert lag(constant).placements.vector("initial") == pytest.approx([1.25, 3.75, 6.25, 8.75])
    assert lag(linear).placements.vector("initial") == pytest.approx([0.0, 2.5, 5.0, 7.5, 10.0])


# --- Known optima ----------------------------------------------------------------------------------------------------


def fastest(distance: float, duration: al.Decision) -> al.Problem:
    """Move a block, from rest to rest, by a force of one at most."""
    return al.Problem(
        Launched(),
        grid=al.Grid(duration, 20),
        inputs={"force": al.Control(0.0, -1.0, 1.0)},
        minimize=al.objectives.final_time(),
        subject_to=[al.terminal("x").mean.equals(distance), al.terminal("v").mean.equals(0.0)],
    )


@each_way
def test_least_time_to_move_a_block_is_bang_bang(way):
    distance = 2.0
    # The barrier of an interior-point method leaves a thousandth of its tolerance for each of the 40 bounds.
    solver = replace(way.solver, tolerance=1e-7)
    solution = al.solve(fastest(distance, al.Decision(4.0, 1.0, 10.0)), solver, transcription=way)
    assert solution.objective == pytest.approx(2 * np.sqrt(distance), rel=1e-8)
    assert solution.decisions["inputs.force"] == pytest.approx(np.repeat([1.0, -1.0], 10), abs=1e-6)
    assert solution.is_at_bound("inputs.force")
    # A force of r instead of 1 takes the time 2 sqrt(d / r): half the time less for each unit, over all bounds.
    prices = solution.bound_multipliers["inputs.force"]
    assert np.abs(prices).sum() == pytest.approx(np.sqrt(distance), rel=1e-5)
    assert (prices * np.repeat([prices[0], -prices[0]], 10) >= 0).all()


def test_a_free_duration_is_not_carried_to_its_bound_by_the_first_steps():
    problem = fastest(1.0, al.Decision(3.0, 1e-9, 10.0))
    assert al.solve(problem).objective == pytest.approx(2.0, rel=1e-8)
