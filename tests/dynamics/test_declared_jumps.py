"""Signals that declare their jumps, and jumps that nothing declares: closed forms of a block that is pushed."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.dynamics import Asked, simulation_of
from compiling import compiled
from zoo import cases, optimum


class Block(al.System):
    """A block of some mass, pushed from rest."""

    states = ("x", "v")
    mass: al.Number = 1.0

    def rhs(self, t, z, push):
        return z.v, push / self.mass

    def outputs(self, t, z, push):
        return {"x": z.x, "v": z.v, "push": push}


class Lag(al.System):
    states = ("x",)

    def rhs(self, t, z, u):
        return (u - z.x,)

    def outputs(self, t, z, u):
        return {"x": z.x}


GRID = al.Grid(1.0, 10)
# Between instants, on one, and on one up to rounding on either side.
TIMES = [0.3337, 0.5, 0.1 * 3, 0.29999999999999993]


def until(time):
    return al.StepFunction([time], [1.0, -1.0])


def reached(time, integrator=None):
    """The end of a push forward until some time, then back, and what it should be."""
    end = al.simulate(Block(), GRID, {"push": until(time)}, integrator)
    back = 1 - time
    return jnp.stack([end["x"][-1], end["v"][-1]]), jnp.stack([time**2 / 2 + time * back - back**2 / 2, time - back])


@pytest.mark.parametrize("integrator", cases([None, al.integrators.Tsit5()]))
def test_a_jump_anywhere_is_exact_and_so_is_its_derivative(integrator):
    def both(time):
        return reached(time, integrator)

    values_and_slopes = jax.jit(jax.vmap(lambda time: (both(time), jax.jacfwd(both)(time))))
    for found, right in values_and_slopes(np.array(TIMES)):
        np.testing.assert_allclose(found, right, rtol=1e-12, atol=1e-13)


def test_outputs_at_a_jump_are_those_after_it_and_jumps_outside_the_grid_are_passed():
    push = al.StepFunction([-1.0, 0.5, 2.0], [7.0, 1.0, -1.0, 5.0])
    end = al.simulate(Block(), al.Grid(1.0, 4), {"push": push})
    assert end["push"].tolist() == [1.0, 1.0, -1.0, -1.0, -1.0]
    np.testing.assert_allclose(end["v"], [0.0, 0.25, 0.5, 0.25, 0.0], atol=1e-15)


def test_no_order_is_lost_at_a_declared_jump():
    u = al.Tabulated([0.0, 0.3, 0.3, 0.7, 0.7, 1.0], [0.0, 0.0, 1.0, 1.0, 0.0, 0.0])
    right = (1 - np.exp(-0.4)) * np.exp(-0.3)
    ends = [np.asarray(al.simulate(Lag(), al.Grid(1.0, n), {"u": u})["x"])[-1] for n in (16, 32)]
    errors = np.abs(np.array(ends) - right)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.1)


def test_middles_of_steps_and_folds_are_those_of_the_grid():
    simulation = simulation_of(Block(), al.Grid(1.0, 4), {"push": until(0.3)}, None)

    def fold(carried, outputs):
        total = outputs["v"] + (0.0 if carried is None else carried)
        return total, {"so far": total}

    asked = Asked(frozenset({"v"}), nodes=frozenset({"x"})), Asked(frozenset({"v"}), fold=fold)
    record, folded = compiled(lambda: [simulation.record(one)[:2] for one in asked])()
    times = np.linspace(0.0, 1.0, 9)
    right = np.where(times < 0.3, times**2 / 2, 0.045 + 0.3 * (times - 0.3) - (times - 0.3) ** 2 / 2)
    np.testing.assert_allclose(record[1]["x"], right, atol=1e-15)
    np.testing.assert_allclose(folded[0]["so far"], np.cumsum(np.asarray(record[0]["v"])), atol=1e-15)


class Pushed(al.System):
    """Nothing but its input."""

    states = ()

    def rhs(self, t, z):
        return ()

    def outputs(self, t, z, push):
        return {"square": push**2}


def test_jumps_in_problems():
    time = al.Decision(0.5, 0.1, 0.9)
    decided = al.Problem(
        Block(al.Uniform(1.0, half_width=0.1)),
        grid=GRID,
        inputs={"push": until(time)},
        minimize=al.terminal("x").mean,
        subject_to=[(al.terminal("v").mean >= 0.0).named("forward")],
    )
    solution = al.solve(decided)
    assert solution.decisions["inputs.push.times.0"] == pytest.approx(0.5, abs=1e-8)
    with pytest.raises(al.ProblemError, match="jumps at a time that is uncertain or decided"):
        al.solve(decided, transcription=al.Simultaneous())


@pytest.mark.parametrize("way", cases([al.Sequential(), al.Simultaneous(al.schemes.Radau(2))]))
def test_integrals_over_a_known_jump_are_exact(way):
    push = al.StepFunction([0.37], [al.Decision(1.0, 0.5, 2.0), 3.0])
    least = {"minimize": al.integral("square").mean, "grid": GRID, "inputs": {"push": push}}
    found = optimum(al.Problem(Pushed(), **least), transcription=way)
    assert found.objective == pytest.approx(0.37 * 0.25 + 0.63 * 9.0, rel=1e-9)


def test_a_collocated_block_sees_each_side_of_a_known_jump():
    problem = al.Problem(
        Block(al.Decision(1.0, 0.5, 2.0)),
        grid=al.Grid(1.0, 4),
        inputs={"push": al.Tabulated([0.0, 0.3, 0.3, 1.0], [1.0, 1.0, -1.0, -1.0])},
        minimize=al.terminal("x").mean,
    )
    found = optimum(problem, transcription=al.Simultaneous())
    assert found.objective == pytest.approx((0.3**2 / 2 + 0.3 * 0.7 - 0.7**2 / 2) / 2.0, abs=1e-7)


# --- Jumps that nothing declares -------------------------------------------------------------------------------------

SILENT = al.processes.signal(lambda t, p: jnp.where(t < 0.3337, 1.0, -1.0))
RAMP = al.processes.signal(lambda t, p: jnp.where(t < 0.3337, t, 0.3337))


def test_a_jump_that_is_not_declared_is_told():
    with pytest.warns(al.GridWarning, match=r"Block: its rates jump at t = 0\.3337 s") as warned:
        al.simulate(Block(), GRID, {"push": SILENT})
    assert warned[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error", al.GridWarning)
        al.simulate(Block(), GRID, {"push": RAMP})


class Staged(al.System):
    """A rate that changes when `change` comes: at once, or without a jump."""

    states = ("x",)
    change: al.Number
    jump: al.Number = 0.0

    def rhs(self, t, z):
        fixed = jnp.where(t < 0.25, 1.0, 0.5)
        return (fixed + jnp.where(t < self.change, t / self.change, 1.0 + self.jump),)

    def outputs(self, t, z):
        return {"x": z.x}


def staged(jump):
    model = Staged(al.Decision(0.5, 0.3, 0.9), jump)
    return al.Problem(model, grid=GRID, minimize=al.terminal("x").mean)


def test_a_jump_at_a_decided_time_is_refused_by_name_and_a_ramp_is_none():
    with pytest.raises(al.ProblemError, match=r"jump at t = 0\.5 s, a time that follows from 'change'.*StepFunction"):
        staged(jump=0.1)
    staged(jump=0.0)


@pytest.mark.parametrize("times", [[0, 0, 1], [0, 0.5, 0.5, 0.5, 1]])
def test_tables_whose_pieces_have_no_length_are_refused(times):
    with pytest.raises(al.ProblemError, match=r"Tabulated: times must increase, but sample \d is not after"):
        al.Tabulated(times, np.zeros(len(times)))


@pytest.mark.parametrize("given", [([1.0], [1.0]), ([2.0, 1.0], [1.0, 2.0, 3.0])])
def test_step_functions_that_are_none_are_refused(given):
    with pytest.raises(al.ProblemError, match="StepFunction: "):
        al.StepFunction(*given)


class Bead(al.Lagrangian):
    """A bead on a rod that turns at 2 rad/s: at a fixed state the rates of its place are rounding beside others."""

    names = ("x", "y")
    constraint_names = ("rod",)

    def kinetic_energy(self, q, v):
        return 0.5 * (v[0] ** 2 + v[1] ** 2)

    def potential_energy(self, q):
        return 0.0 * q[1]

    def constraint(self, q, t):
        return (q[0] * jnp.sin(2 * t) - q[1] * jnp.cos(2 * t),)


@pytest.mark.slow
def test_rounding_is_no_jump():
    system = al.ForwardDynamics(Bead(), start={"x": 1.0, "x_rate": 0.0, "y_rate": 2.0})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        motion = al.simulate(system, al.Grid(1.0, 100))
    assert motion["x"][-1] == pytest.approx(np.cosh(2) * np.cos(2), rel=1e-6)
