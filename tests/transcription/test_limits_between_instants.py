"""Limits hold between the instants of a grid too: of plans, at jumps of torques, and beside ripples and pulses."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import linprog, minimize

import aleator as al
import zoo
from aleator.certification._between import Margin, jumps, tightened
from aleator.nlp import FilterSQP, Status
from aleator.transcription import transcribe
from zoo import Pendulum

# --- Plans -----------------------------------------------------------------------------------------------------------


def plan(*limits, steps=4, free=8, degree=3, gravity=0.0, end=1.0, **options):
    """From rest to rest in the least time, with a torque within limits: without gravity a mass on a rail."""
    ends = {"start": (0.0, 0.0), "end": (end, 0.0)}
    points = al.fit_control_points(np.linspace(0.0, end, 200), free, degree=degree, **ends)
    motion = al.BSpline(al.Decision(points, -3.0, 4.0), degree=degree, **ends)
    pendulum = Pendulum(mass=al.Uniform(1.0, half_width=0.1), gravity=gravity)
    return al.Problem(
        al.InverseDynamics(pendulum, motion={"angle": motion}),
        **{"grid": al.Grid(al.Decision(2.0, 0.1, 20.0), steps), "minimize": al.objectives.final_time()} | options,
        subject_to=limits or [al.path("angle_torque").within(-10.0, 10.0, sigmas=1.0)],
        expansion=al.Expansion(order=1),
    )


def test_a_plan_that_breaks_its_limits_between_too_few_instants_is_no_solution():
    refused = al.solve(plan(), refine=False, throw=False)
    assert "limits break between the instants" in refused.verdict
    assert "between the instants of the grid 'angle_torque' exceeds" in refused.why()
    assert refused.certificate.between.worst > 1e-3
    assert al.solve(plan(), between=1).ok
    finer = al.solve(plan())
    assert finer.ok
    assert finer.problem.grid.steps > plan().grid.steps


def test_an_interruption_while_limits_are_tightened_is_not_swallowed(monkeypatch):
    solve, calls = FilterSQP.solve, []

    def interrupted(self, program, **options):
        calls.append(program)
        outcome = solve(self, program, **options)
        return outcome if len(calls) == 1 else outcome.__class__(**(vars(outcome) | {"status": Status.INTERRUPTED}))

    monkeypatch.setattr(FilterSQP, "solve", interrupted)
    with pytest.raises(KeyboardInterrupt):
        al.solve(plan())
    assert len(calls) == 2


def test_the_sides_of_a_jump_are_continued_to_it():
    fine = np.arange(21.0)
    values = np.where(fine < 7.3, 2.0 + 0.1 * fine, -1.0 + 0.2 * fine)[:, None]
    ((place, before, after),) = jumps(values, np.array([7.3]))
    assert place == pytest.approx(7.3)
    assert before == pytest.approx([2.73])
    assert after == pytest.approx([0.46])
    assert jumps(np.sin(fine / 5)[:, None], np.array([0.3, 0.7])) == []


# --- What all instants of a grid and of its refinements share, or miss -----------------------------------------------


class Rippled(al.System):
    """A level with a ripple on it, which is known in closed form."""

    states = ("q",)
    level: al.Number
    depth: al.Number
    ripple: al.Number = 0.0
    best: al.Number = 3.0

    def rhs(self, t, z):
        return (self.level - z.q,)

    def outputs(self, t, z):
        wave = jnp.sin(2 * jnp.pi * self.ripple * t)
        return {"i": self.level * (1.0 + self.depth * wave), "loss": (self.level - self.best) ** 2}


def rippled(high=9e3, low=-9e3, peak=9e3, ripple=0.0):
    i = al.path("i")
    limits = [i.at_most(high, sigmas=2.0).named("high"), i.at_least(low).named("low"), al.peak("i").at_most(peak)]
    system = Rippled(al.Decision(1.0, 0.1, 10.0), al.Uniform(0.5, half_width=0.05), ripple)
    return al.Problem(system, grid=al.Grid(1.0, 100), minimize=al.terminal("loss").mean, subject_to=limits)


def answer(between=None, **options):
    return al.solve(rippled(**options), between=between, refine=False, throw=False)


@pytest.mark.filterwarnings("ignore")
def test_a_ripple_that_all_instants_share_breaks_the_limit():
    frequency = 400.0
    # The best level with which two standard deviations above the peak of the ripple are at the limit.
    best = 1.5 / (1 + 0.5 + 2 * 0.05 / np.sqrt(3))
    solution = answer(high=1.5, ripple=frequency)
    assert solution.ok
    assert solution.decisions["level"] <= best * 1.01
    # Every interval is narrowed by all of the ripple on both sides, and that is said.
    assert solution.certificate.between.is_costly
    at_instants = answer(high=1.5, ripple=frequency, between=1)
    assert at_instants.decisions["level"] == pytest.approx(1.5, rel=1e-6)
    of_peak = answer(peak=1.5, ripple=frequency)
    assert not of_peak.ok
    assert "do not tell whether it holds" in of_peak.why()


def test_margins_narrow_both_sides_of_a_limit_at_their_instants():
    transcribed, margins = transcribe(rippled(high=1.5, low=-1.0)), np.linspace(0.0, 0.2, 101)
    margin = Margin(margins[:, None], {})
    high, low, peak = transcribed.rows
    narrower = tightened(transcribed, (margin, margin, None))
    np.testing.assert_allclose(narrower.constraint_upper[high], 1.5 - margins)
    np.testing.assert_allclose(narrower.constraint_lower[low], margins - 1.0)
    np.testing.assert_array_equal(narrower.constraint_upper[peak], transcribed.program.constraint_upper[peak])


# --- Peaks and their prices ------------------------------------------------------------------------------------------


class Damped(al.System):
    """A unit mass pushed off at unit speed, `x = exp(-c t / 2) sin(w t) / w` with `w² = k - c² / 4`."""

    states = ("x", "v")
    stiffness: al.Number
    damping: al.Number
    side: float = 1.0

    def initial(self):
        return {"v": 1.0}

    def rhs(self, t, z):
        return z.v, -self.stiffness * z.x - self.damping * z.v

    def outputs(self, t, z):
        return {"x": self.side * z.x, "a": self.stiffness * z.x + self.damping * z.v}


def gentlest(bound):
    """The least root mean square of the acceleration over 2 s that brakes the mass within a bound, by SciPy."""

    def reach_and_effort(x):
        k, c = x
        frequency = np.emath.sqrt(k - c * c / 4)
        times, weights = np.polynomial.legendre.leggauss(60)
        times = np.append(times + 1.0, np.real(np.arctan(2 * frequency / c) / frequency))
        position = np.real(np.exp(-c * times / 2) * np.sin(frequency * times) / frequency)
        speed = np.real(np.exp(-c * times / 2) * np.cos(frequency * times)) - c / 2 * position
        return position[-1], np.sqrt(weights @ (k * position + c * speed)[:-1] ** 2 / 2)

    limit = {"type": "ineq", "fun": lambda x: bound - reach_and_effort(x)[0]}
    found = minimize(lambda x: reach_and_effort(x)[1], [8.0, 4.0], constraints=limit, options={"ftol": 1e-13})
    assert found.success
    return found.fun


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["peak", "trough"])
def test_optimum_and_price_of_a_path_do_not_depend_on_where_the_instants_are(side):
    path, bound = al.path("x"), 0.15
    limit = path.at_most(bound) if side > 0 else path.at_least(-bound)
    system = Damped(al.Decision(20.0, 1.0, 500.0), al.Decision(2.0, 0.1, 20.0), side)
    problem = al.Problem(system, grid=al.Grid(2.0, 30), minimize=al.rms("a").mean, subject_to=[limit])
    solution = al.solve(problem)
    assert solution.objective == pytest.approx(gentlest(bound), rel=1e-4)
    slope = (gentlest(bound - 1e-3) - gentlest(bound + 1e-3)) / 2e-3
    assert solution.constraints[0].shadow_price == pytest.approx(slope, rel=5e-3)
    assert solution.certificate.between.cost == 0.0  # no bound is tighter than it has to be


# --- Inputs that jump ------------------------------------------------------------------------------------------------


class Tank(al.System):
    """A level that follows an inflow, which the pressure shows at once."""

    states = ("level",)
    gain: al.Number = 1.0

    def rhs(self, t, z, inflow):
        return (self.gain * inflow - z.level,)

    def outputs(self, t, z, inflow):
        return {"level": z.level, "pressure": z.level + 0.5 * self.gain * inflow}


@pytest.mark.parametrize(("end", "steps"), zoo.cases([(1.37, 20), (1.5, 20)]))
def test_a_limit_holds_up_to_a_declared_jump_and_no_further_than_it_has_to(end, steps):
    problem = al.Problem(
        Tank(al.Decision(1.0, 0.01, 9.0)),
        grid=al.Grid(3.0, steps),
        inputs={"inflow": al.StepFunction([end], [1.0, 0.0])},
        minimize=-al.value("gain"),
        subject_to=[al.path("pressure").at_most(1.0)],
    )
    solution = al.solve(problem)
    right = 1 / (1.5 - np.exp(-end))
    assert right * (1 - 2e-3) < -solution.objective < right * (1 + 1e-5)


def test_a_control_that_is_constant_in_each_step_keeps_its_limit_at_both_ends_of_it():
    problem = al.Problem(
        Tank(),
        grid=al.Grid(2.0, 8),
        inputs={"inflow": al.Control(0.1, -1.0, 1.0, degree=0)},
        minimize=-al.terminal("level").mean,
        subject_to=[al.path("pressure").at_most(0.6)],
    )
    # The level at the ends of steps, by the inflows, exactly.
    decay, steps = np.exp(-0.25), np.arange(8)
    ends = np.tril(decay ** (steps[:, None] - steps)) * (1 - decay)
    starts = np.vstack([np.zeros(8), ends[:-1]])
    rows = np.vstack([starts, ends]) + 0.5 * np.vstack([np.eye(8), np.eye(8)])

    def lowest(bound):
        return linprog(-ends[-1], rows, np.full(16, bound), bounds=(-1.0, 1.0)).fun

    solution = al.solve(problem)
    assert solution.objective == pytest.approx(lowest(0.6), rel=1e-5)
    price = (lowest(0.599) - lowest(0.601)) / 2e-3
    assert solution.constraints[0].shadow_price == pytest.approx(price, rel=1e-3)
