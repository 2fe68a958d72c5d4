"""Controls whose values on the mesh are decisions: what they are as functions of time, and optima that are known."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.design import history
from aleator.trajectories import Piecewise, piecewise_in
from aleator.transcription import started_from, transcribe
from aleator.transcription.simultaneous._tiles import EVALUATE
from aleator.transcription.simultaneous._transcribed import SimultaneouslyTranscribed

LEVELS = np.array([1.0, -2.0, 0.5, 3.0])


class Lag(al.System):
    """`x' = (u - x) / τ` from zero."""

    states = ("x",)
    lag: al.Number = 1.0

    def rhs(self, t, z, u):
        return ((u - z.x) / self.lag,)

    def outputs(self, t, z, u):
        return {"x": z.x, "u": u, "u²": u**2}


class Block(al.System):
    """A unit mass on a rail."""

    states = ("x", "v")
    speed: al.Number = 0.0

    def rhs(self, t, z, u):
        return z.v, u

    def outputs(self, t, z, u):
        return {"x": z.x, "v": z.v, "u²/2": u**2 / 2}

    def initial(self):
        return {"v": self.speed}


class VanDerPol(al.System):
    """The oscillator, pushed."""

    states = ("x1", "x2")

    def rhs(self, t, z, u):
        return (1 - z.x2**2) * z.x1 - z.x2 + u, z.x1

    def outputs(self, t, z, u):
        return {"cost": z.x1**2 + z.x2**2 + u**2, "x1": z.x1}

    def initial(self):
        return {"x2": 1.0}


class Gust(al.System):
    """A lag with a load beside its input."""

    states = ("x",)

    def rhs(self, t, z, u, load):
        return (u - z.x + load,)

    def outputs(self, t, z, u, load):
        return {"x": z.x, "cost": z.x**2 + (u - 1) ** 2}


class Gain(al.System):
    """Nothing is integrated: the output follows from the input at once."""

    states = ()

    def rhs(self, t, z, u):
        return ()

    def outputs(self, t, z, u):
        return {"t u²": t * u**2}


class Cart(al.Mechanical):
    """A unit mass that is pushed."""

    names = ("x",)

    def mass_matrix(self, q):
        return jnp.eye(1)


def lag(control: Any, integrator: Any = None, **options: Any) -> al.Problem:
    defaults: dict[str, Any] = {"grid": al.Grid(2.0, 4), "minimize": al.terminal("x").mean}
    return al.Problem(Lag(), inputs={"u": control}, integrator=integrator, **(defaults | options))


def stepped(t: float) -> float:
    """`x` of the lag in closed form, where `u` is constant over each half of a second."""
    x, at = 0.0, 0.0
    for level in LEVELS:
        x, at = level + (x - level) * np.exp(-min(0.5, max(t - at, 0.0))), at + 0.5
    return x


def states_at(problem: al.Problem, decisions: np.ndarray) -> dict[str, np.ndarray]:
    found = history(problem, jnp.zeros(0), jnp.asarray(decisions))
    return {name: np.asarray(values) for name, values in found.items()}


# --- What it is as a function of time --------------------------------------------------------------------------------


METHODS = {"order 4": al.integrators.RungeKutta4(), "order 5": al.integrators.RungeKutta4().reference()}


@pytest.mark.parametrize(("method", "order"), [("order 4", 4), ("order 5", 5)])
def test_no_order_is_lost_where_a_control_jumps(method, order):
    problem = lag(al.Control(LEVELS))
    errors = []
    for steps in (4, 8, 16):
        grid = al.Grid(2.0, steps)
        found = states_at(problem.on_grid(grid, METHODS[method]), LEVELS)["x"]
        errors.append(np.abs(found - [stepped(t) for t in grid.times]).max())
    assert np.log2(errors[1] / errors[2]) == pytest.approx(order, abs=0.35)


@pytest.mark.parametrize("integrator", [al.integrators.Tsit5(), al.integrators.Kvaerno5()], ids=["Tsit5", "Kvaerno5"])
def test_integrators_with_steps_of_their_own_stop_at_jumps(integrator):
    problem = lag(al.Control(LEVELS), integrator, grid=al.Grid(2.0, 4))
    found = states_at(problem, LEVELS)["x"]
    assert found == pytest.approx([stepped(t) for t in problem.grid.times], abs=1e-7)


@pytest.mark.parametrize("steps", [3, 7, 20])
def test_on_another_grid_it_is_the_same_function_of_time(steps):
    problem = lag(al.Control(LEVELS)).on_grid(al.Grid(2.0, steps))
    found, times = states_at(problem, LEVELS), np.linspace(0.0, 2.0, steps + 1)
    assert found["x"] == pytest.approx([stepped(t) for t in times], abs=2e-3)
    within = np.minimum((2 * times + 1e-9).astype(int), 3)
    assert found["u"] == pytest.approx(LEVELS[within])


def test_a_linear_control_passes_through_its_values():
    values = np.array([0.0, 2.0, -1.0, 1.0, 0.5])
    found = states_at(lag(al.Control(values, degree=1)).on_grid(al.Grid(2.0, 40)), values)
    assert found["u"] == pytest.approx(np.interp(np.linspace(0.0, 2.0, 41), np.linspace(0.0, 2.0, 5), values))


@pytest.mark.slow
def test_integrals_over_jumps_are_those_of_each_step_of_its_own():
    """Of a system with states, of one without, and both ways: polynomials that every rule integrates exactly."""
    squared = 0.5 * float(LEVELS @ LEVELS)
    moving = lag(al.Control(LEVELS), minimize=al.integral("u²").mean)
    still = al.Problem(
        Gain(), grid=al.Grid(2.0, 4), inputs={"u": al.Control(LEVELS)}, minimize=al.integral("t u²").mean
    )
    first = float(np.array([0.125, 0.375, 0.625, 0.875]) @ LEVELS**2)
    for way in BOTH.values():
        for problem, exact in ((moving, squared), (still, first)):
            program = transcribe(problem, way).program
            assert program.evaluate(program.start).objective == pytest.approx(exact, rel=1e-12)


class Own(al.System):
    """A unit mass on a rail that holds its own control."""

    states = ("x", "v")
    u: al.Number = 0.0

    def rhs(self, t, z):
        return z.v, self.u(t)

    def outputs(self, t, z):
        return {"x": z.x}


def test_a_control_that_jumps_in_the_place_of_a_number_is_refused_with_what_to_do():
    with pytest.raises(al.ProblemError, match=r'Own.u: an al.Control of degree 0 jumps.*inputs=\{"u": al.Control'):
        al.Problem(Own(u=al.Control(0.0, -5.0, 5.0)), grid=al.Grid(1.0, 4), minimize=al.terminal("x").mean)
    held = al.Control(0.0, -5.0, 5.0, degree=1)
    problem = al.Problem(Own(u=held), grid=al.Grid(1.0, 4), minimize=al.terminal("x").mean)
    # Least where the push is at its bound throughout.
    assert al.solve(problem, between=1).objective == pytest.approx(-2.5, rel=1e-6)


def test_an_objective_of_several_numbers_is_refused_before_anything_is_compiled():
    with pytest.raises(al.ProblemError, match=r"The objective must be one number, but .* has shape \(4,\)"):
        al.Problem(
            Lag(),
            grid=al.Grid(1.0, 4),
            inputs={"u": al.Control(0.0, -1.0, 1.0)},
            minimize=al.terminal("x").mean - al.value("inputs.u"),
        )


def test_a_function_is_a_start():
    constant, linear = (al.Control(lambda s: 10 * s, degree=degree) for degree in (0, 1))
    assert lag(constant).placements.vector("initial") == pytest.approx([1.25, 3.75, 6.25, 8.75])
    assert lag(linear).placements.vector("initial") == pytest.approx([0.0, 2.5, 5.0, 7.5, 10.0])


def test_forces_of_mechanical_systems_may_jump():
    problem = al.Problem(
        al.ForwardDynamics(Cart(), torque={"x_torque": al.Control(LEVELS)}),
        grid=al.Grid(2.0, 4),
        minimize=al.terminal("x_rate").mean,
    )
    assert states_at(problem, LEVELS)["x_rate"] == pytest.approx(np.append(0.0, 0.5 * np.cumsum(LEVELS)))


# --- Known optima ----------------------------------------------------------------------------------------------------


BOTH = {
    "shooting": al.Sequential(),
    "collocation": al.Simultaneous(),
    "Radau": al.Simultaneous(al.schemes.Radau(2)),
    "segments": al.Simultaneous(al.schemes.MultipleShooting(2)),
}


@pytest.mark.slow
@pytest.mark.parametrize("way", BOTH)
def test_least_time_to_move_a_block_is_bang_bang(way):
    distance = 2.0
    problem = al.Problem(
        Block(),
        grid=al.Grid(al.Decision(4.0, 1.0, 10.0), 10),
        inputs={"u": al.Control(0.0, -1.0, 1.0)},
        minimize=al.objectives.final_time(),
        subject_to=[al.terminal("x").mean.equals(distance), al.terminal("v").mean.equals(0.0)],
    )
    solution = al.solve(problem, transcription=BOTH[way])
    assert solution.objective == pytest.approx(2 * np.sqrt(distance), rel=1e-8)
    assert solution.decisions["inputs.u"] == pytest.approx(np.repeat([1.0, -1.0], 5), abs=1e-6)
    assert solution.is_at_bound("inputs.u")
    # A force of r instead of 1 takes the time 2 sqrt(d / r): half the time less for each unit, over all bounds.
    prices = solution.bound_multipliers["inputs.u"]
    assert np.abs(prices).sum() == pytest.approx(np.sqrt(distance), rel=1e-5)
    assert (prices * np.repeat([prices[0], -prices[0]], 5) >= 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("way", BOTH)
def test_bryson_and_denham(way):
    """4 / (9 l), with forces that are linear between thirds of the time."""
    limit = 1 / 9
    problem = al.Problem(
        Block(speed=1.0),
        grid=al.Grid(1.0, 30),
        inputs={"u": al.Control(0.0, degree=1)},
        minimize=al.integral("u²/2").mean,
        subject_to=[
            al.terminal("x").mean.equals(0.0),
            al.terminal("v").mean.equals(-1.0),
            al.path("x").at_most(limit),
        ],
    )
    solution = al.solve(problem, transcription=BOTH[way])
    assert solution.objective == pytest.approx(4 / (9 * limit), rel=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("degree", "steps", "above"), [(0, 50, 1e-3), (1, 50, 2e-5)])
def test_controls_follow_a_mesh_that_is_refined(degree, steps, above):
    """Van der Pol's oscillator: 2.87330. What a control cannot follow costs a little more."""
    problem = al.Problem(
        VanDerPol(),
        grid=al.Grid(10.0, steps),
        inputs={"u": al.Control(0.0, -1.0, 1.0, degree=degree)},
        minimize=al.integral("cost").mean,
    )
    coarse = al.solve(problem, transcription=al.Simultaneous())
    solution = al.solve(problem, transcription=al.Simultaneous(error=1e-7))
    assert 2.87330 - 1e-5 <= solution.objective <= 2.87330 + above
    assert solution.objective < coarse.objective
    nodes = solution.meshes[-1].nodes / 10.0
    (control,) = piecewise_in(solution.problem.simulation)
    assert control.nodes == pytest.approx(nodes)
    assert solution.decisions["inputs.u"].shape == (len(nodes) - 1 + degree,)
    assert len(nodes) > steps + 1
    again = al.solve(solution.problem, transcription=al.Simultaneous(), warm_start=solution)
    assert again.objective == pytest.approx(solution.objective, rel=1e-7)


def test_rates_and_outputs_are_compiled_once_for_all_meshes():
    problem = al.Problem(
        VanDerPol(),
        grid=al.Grid(10.0, 30),
        inputs={"u": al.Control(0.0, -1.0, 1.0)},
        minimize=al.integral("cost").mean,
        subject_to=[al.path("x1").within(-5.0, 5.0)],
    )
    first = transcribe(problem, al.Simultaneous(error=1e-7))
    outcome = al.solvers.Ipopt().solve(first.program)
    before = EVALUATE.compilations
    refined = first.refined(outcome.point)
    assert refined is not None
    # What is compiled anew tells signals, and initial states, integrals and limits.
    assert EVALUATE.compilations - before == 2


def test_by_shooting_van_der_pol_is_as_good_on_the_same_nodes():
    problem = al.Problem(
        VanDerPol(),
        grid=al.Grid(10.0, 80),
        inputs={"u": al.Control(0.0, -1.0, 1.0, degree=1)},
        minimize=al.integral("cost").mean,
    )
    assert al.solve(problem).objective == pytest.approx(2.87330, abs=3e-5)


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


def test_a_warm_start_on_other_nodes_is_the_same_function():
    def problem(steps: int, degree: int) -> al.Problem:
        return lag(
            al.Control(0.0, -5.0, 5.0, degree=degree),
            grid=al.Grid(2.0, steps),
            minimize=al.integral("u²").mean,
            subject_to=[al.terminal("x").mean.equals(1.0)],
        )

    coarse = al.solve(problem(4, 0))
    assert started_from(problem(8, 0), coarse) == pytest.approx(np.repeat(coarse.vector, 2))


def test_a_control_of_a_thousand_values_is_as_sparse_as_its_mesh():
    problem = lag(al.Control(0.0, degree=1), grid=al.Grid(2.0, 1000), minimize=al.integral("u²").mean)
    transcribed = transcribe(problem, al.Simultaneous())
    assert isinstance(transcribed, SimultaneouslyTranscribed)
    # Each instant depends on its own value, and each middle of a step on two.
    assert transcribed.assembled.slopes.nnz == 1001 + 2 * 1000


# --- What is refused -------------------------------------------------------------------------------------------------


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
        (lambda: lag(al.Control(lambda s: "high")), "function of the fraction"),
        (lambda: lag(al.Control(lambda s: 1 / 0)), "of the duration, raised ZeroDivisionError"),
        (lambda: al.simulate(Lag(), al.Grid(1.0, 4), {"u": al.Control(0.0)}), "by itself it has none"),
        (lambda: al.InverseDynamics(Cart(), motion={"x": al.Control(0.0, degree=1)}), "velocity and acceleration"),
    ],
)
def test_what_makes_no_control_is_refused_in_one_sentence(made, told):
    with pytest.raises(al.ProblemError, match=None) as refused:
        made()
    assert told in str(refused.value)


def test_it_is_one_trajectory_with_its_nodes_inside_a_problem():
    (found,) = piecewise_in(lag(al.Control(0.0, degree=1)).simulation)
    assert isinstance(found, Piecewise)
    assert found.nodes == (0.0, 0.25, 0.5, 0.75, 1.0)
