"""Controls whose values on the mesh are decisions: what they are as functions of time, and optima that are known."""

from functools import cache
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.design import history
from aleator.trajectories import Piecewise, piecewise_in
from aleator.transcription import transcribe
from aleator.transcription.simultaneous._tiles import EVALUATE
from aleator.transcription.simultaneous._transcribed import SimultaneouslyTranscribed
from compiling import compiled
from zoo import Launched, Pendulum

LEVELS, VALUES = np.array([1.0, -2.0, 0.5, 3.0]), np.array([0.0, 2.0, -1.0, 1.0, 0.5])
WAYS = {
    "shooting": al.Sequential(),
    "collocation": al.Simultaneous(),
    "Radau": al.Simultaneous(al.schemes.Radau(2)),
    "segments": al.Simultaneous(al.schemes.MultipleShooting(2)),
}
each_way = pytest.mark.parametrize(
    "way", [pytest.param(way, marks=[pytest.mark.slow] * (i > 1)) for i, way in enumerate(WAYS.values())], ids=WAYS
)


class Lag(al.System):
    """`x' = (u - x) / τ` from zero."""

    states = ("x",)
    lag: al.Number = 1.0

    def rhs(self, t, z, u):
        return ((u - z.x) / self.lag,)

    def outputs(self, t, z, u):
        return {"x": z.x, "u": u, "u²": u**2}


class VanDerPol(al.System):
    """The oscillator, pushed."""

    states = ("x1", "x2")

    def rhs(self, t, z, u):
        return (1 - z.x2**2) * z.x1 - z.x2 + u, z.x1

    def outputs(self, t, z, u):
        return {"cost": z.x1**2 + z.x2**2 + u**2, "x1": z.x1}

    def initial(self):
        return {"x2": 1.0}


def lag(control: Any, integrator: Any = None, **options: Any) -> al.Problem:
    defaults: dict[str, Any] = {"grid": al.Grid(2.0, 4), "minimize": al.terminal("x").mean}
    return al.Problem(Lag(), inputs={"u": control}, integrator=integrator, **(defaults | options))


def van_der_pol(steps: int, degree: int) -> al.Problem:
    """2.87330, or a little more, as much as a control cannot follow."""
    control = al.Control(0.0, -1.0, 1.0, degree=degree)
    return al.Problem(VanDerPol(), grid=al.Grid(10.0, steps), inputs={"u": control}, minimize=al.integral("cost").mean)


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

    return dict(zip(problems, run(LEVELS, VALUES), strict=True))


@pytest.mark.parametrize("order", [4, 5])
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


@pytest.mark.slow
@pytest.mark.parametrize("integrator", [al.integrators.Tsit5(), al.integrators.Kvaerno5()], ids=["Tsit5", "Kvaerno5"])
def test_integrators_with_steps_of_their_own_stop_at_jumps(integrator):
    problem = lag(al.Control(LEVELS), integrator)
    found = compiled(lambda levels: history(problem, jnp.zeros(0), levels)["x"])(LEVELS)
    assert found == pytest.approx(stepped(problem.grid.times), abs=1e-7)


@each_way
def test_integrals_over_jumps_are_those_of_each_step_of_its_own(way):
    program = transcribe(lag(al.Control(LEVELS), minimize=al.integral("u²").mean), way).program
    assert program.evaluate(program.start).objective == pytest.approx(0.5 * float(LEVELS @ LEVELS), rel=1e-12)


def test_a_function_is_a_start():
    constant, linear = (al.Control(lambda s: 10 * s, degree=degree) for degree in (0, 1))
    assert lag(constant).placements.vector("initial") == pytest.approx([1.25, 3.75, 6.25, 8.75])
    assert lag(linear).placements.vector("initial") == pytest.approx([0.0, 2.5, 5.0, 7.5, 10.0])


def test_it_is_one_trajectory_with_its_nodes_inside_a_problem():
    (found,) = piecewise_in(lag(al.Control(0.0, degree=1)).simulation)
    assert isinstance(found, Piecewise)
    assert found.nodes == (0.0, 0.25, 0.5, 0.75, 1.0)


def test_a_control_of_many_values_is_as_sparse_as_its_mesh():
    problem = lag(al.Control(0.0, degree=1), grid=al.Grid(2.0, 100), minimize=al.integral("u²").mean)
    transcribed = transcribe(problem, al.Simultaneous())
    assert isinstance(transcribed, SimultaneouslyTranscribed)
    # Each instant depends on its own value, and each middle of a step on two.
    assert transcribed.assembled.slopes.nnz == 101 + 2 * 100


# --- Known optima ----------------------------------------------------------------------------------------------------


@each_way
def test_least_time_to_move_a_block_is_bang_bang(way):
    distance = 2.0
    problem = al.Problem(
        Launched(),
        grid=al.Grid(al.Decision(4.0, 1.0, 10.0), 10),
        inputs={"force": al.Control(0.0, -1.0, 1.0)},
        minimize=al.objectives.final_time(),
        subject_to=[al.terminal("x").mean.equals(distance), al.terminal("v").mean.equals(0.0)],
    )
    solution = al.solve(problem, transcription=way)
    assert solution.objective == pytest.approx(2 * np.sqrt(distance), rel=1e-8)
    assert solution.decisions["inputs.force"] == pytest.approx(np.repeat([1.0, -1.0], 5), abs=1e-6)
    assert solution.is_at_bound("inputs.force")
    # A force of r instead of 1 takes the time 2 sqrt(d / r): half the time less for each unit, over all bounds.
    prices = solution.bound_multipliers["inputs.force"]
    assert np.abs(prices).sum() == pytest.approx(np.sqrt(distance), rel=1e-5)
    assert (prices * np.repeat([prices[0], -prices[0]], 5) >= 0).all()


def test_a_control_follows_a_mesh_that_is_refined_for_which_rates_are_not_compiled_again():
    first = transcribe(van_der_pol(30, 0), al.Simultaneous(error=1e-7))
    outcome = al.solvers.Ipopt().solve(first.program)
    before = EVALUATE.compilations
    finer, point = first.refined(outcome.point)
    # What is compiled anew tells signals, and initial states and integrals.
    assert EVALUATE.compilations - before <= 2
    (control,) = piecewise_in(finer.problem.simulation)
    assert control.nodes == pytest.approx(finer.meshes_at(point)[-1].nodes / 10.0)
    assert len(control.nodes) > 31
    found = finer.decisions(point)
    assert found.shape == (len(control.nodes) - 1,)
    # The same function of time as before.
    middles = (np.array(control.nodes[1:]) + control.nodes[:-1]) / 2
    assert found == pytest.approx(first.decisions(outcome.point)[(30 * middles).astype(int)], abs=1e-9)


@pytest.mark.slow
def test_van_der_pol_is_as_good_by_shooting_as_on_a_mesh_that_is_refined():
    solution = al.solve(van_der_pol(50, 1), transcription=al.Simultaneous(error=1e-7))
    assert 2.87330 - 1e-5 <= solution.objective <= 2.87330 + 2e-5
    again = al.solve(solution.problem, transcription=al.Simultaneous(), warm_start=solution)
    assert again.objective == pytest.approx(solution.objective, rel=1e-7)
    assert al.solve(van_der_pol(80, 1)).objective == pytest.approx(2.87330, abs=3e-5)


class Gust(al.System):
    """A lag with a load beside its input."""

    states = ("x",)

    def rhs(self, t, z, u, load):
        return (u - z.x + load,)

    def outputs(self, t, z, u, load):
        return {"x": z.x, "cost": z.x**2 + (u - 1) ** 2}


@pytest.mark.slow
def test_a_family_of_systems_under_a_random_load_is_the_same_both_ways():
    """Where loads are uncertain, signals are no variables: both sides of a jump are told in each block."""
    load = al.processes.RandomProcess(
        al.processes.SquaredExponentialCovariance(1.0), t_final=2.0, std=0.3, mean=0.2, modes=2
    )
    problem = al.Problem(
        Gust(),
        grid=al.Grid(2.0, 10),
        inputs={"u": al.Control(0.0, -3.0, 3.0), "load": load},
        minimize=al.integral("cost").mean,
        expansion=al.Expansion(order=2),
    )
    shot = al.solve(problem.on_grid(al.Grid(2.0, 60)))
    for scheme in (al.schemes.Radau(3), al.schemes.MultipleShooting(6)):
        tied = al.solve(problem, transcription=al.Simultaneous(scheme))
        assert tied.objective == pytest.approx(shot.objective, rel=1e-6)
        assert tied.decisions["inputs.u"] == pytest.approx(shot.decisions["inputs.u"], abs=1e-4)


# --- What is refused -------------------------------------------------------------------------------------------------


class Own(al.System):
    """A unit mass on a rail that holds its own control."""

    states = ("x", "v")
    u: al.Number = 0.0

    def rhs(self, t, z):
        return z.v, self.u(t)

    def outputs(self, t, z):
        return {"x": z.x}


@pytest.mark.parametrize(
    ("made", "told"),
    [
        (lambda: al.Control(0.0, degree=2), "al.BSpline"),
        (lambda: al.Control(0.0, 1.0, -1.0), "must not exceed"),
        (lambda: al.Control(2.0, -1.0, 1.0), "between its bounds"),
        (lambda: al.Control(np.zeros(4), np.zeros(3)), "3 and 4"),
        (lambda: lag(al.Control(np.zeros(5))), "one number or 4, one for each of the steps of the grid; received 5"),
        (lambda: lag(al.Control(np.zeros(4), degree=1)), "5, one for each of the instants"),
        (lambda: lag(al.Control(0.0, np.full(3, -1.0))), "`lower`"),
        (lambda: lag(al.Control(lambda s: 4 * s, -1.0, 1.0)), "between its bounds"),
        (lambda: lag(al.Control(lambda s: 1 / 0)), "of the duration, raised ZeroDivisionError"),
        (lambda: al.simulate(Lag(), al.Grid(1.0, 4), {"u": al.Control(0.0)}), "by itself it has none"),
        (lambda: al.InverseDynamics(Pendulum(), motion={"angle": al.Control(0.0, degree=1)}), "velocity and accelera"),
        (
            lambda: al.Problem(Own(u=al.Control(0.0)), grid=al.Grid(1.0, 4), minimize=al.terminal("x").mean),
            "Own.u: an al.Control of degree 0 jumps",
        ),
        (
            lambda: lag(al.Control(0.0), minimize=al.terminal("x").mean - al.value("inputs.u")),
            "The objective must be one number, but",
        ),
    ],
)
def test_what_makes_no_control_is_refused_in_one_sentence(made, told):
    with pytest.raises(al.ProblemError) as refused:
        made()
    assert told in str(refused.value)
