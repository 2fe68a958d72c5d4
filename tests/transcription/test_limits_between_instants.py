"""Solutions say what a finer grid shows of them, and are none where their limits break there."""

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.certification._between import excess_between
from aleator.certification._reference import reference
from aleator.design import is_over_time
from aleator.nlp import FilterSQP, Status
from aleator.transcription import transcribe


class Cart(al.Mechanical):
    """A mass on a rail, from rest to rest, and how far it is from a wavy path."""

    names = ("x",)
    mass: al.Number = al.parameter("kg", positive=True)

    def mass_matrix(self, q):
        del q
        return jnp.array([[self.mass]])

    def coriolis(self, q, v):
        del q, v
        return jnp.zeros((1, 1))

    def outputs(self, motion):
        return {"off": motion.q[0] - 0.3 * jnp.sin(5 * motion.t), "speed": motion.v[0]}


def problem(*constraints, steps=12, free=6, minimize=None, t_final=None):
    points = al.Decision(np.linspace(0.2, 0.8, free)[:, None], -3.0, 3.0)
    motion = al.BSpline(points, start=(0.0, 0.0), end=(np.array([1.0]), 0.0))
    return al.Problem(
        al.InverseDynamics(Cart(mass=al.Uniform(1.0, half_width=0.1)), motion=motion),
        grid=al.Grid(t_final or al.Decision(2.0, 0.1, 20.0), steps),
        minimize=al.objectives.final_time() if minimize is None else minimize,
        subject_to=constraints or [al.path("x_torque").within(-10.0, 10.0, sigmas=1.0)],
        expansion=al.Expansion(order=2),
    )


def test_a_plan_that_breaks_its_limits_between_too_few_instants_is_no_solution():
    coarse = problem(steps=4, free=8)
    with pytest.raises(al.SolveError, match=r"between the instants of the grid 'x_torque' exceeds .* use more steps"):
        al.solve(coarse)
    kept = al.solve(coarse, throw=False)
    assert kept.status is Status.NOT_HELD
    assert not kept.ok
    assert kept.certificate.between.worst > 1e-3
    assert al.solve(coarse, between=1).ok


def test_a_plan_that_holds_says_on_how_many_steps():
    solution = al.solve(problem(), between=5)
    assert solution.certificate.between.factor >= 5
    assert solution.certificate.between.holds
    assert f"hold on {solution.certificate.between.factor} times as many steps" in str(solution)


def test_peaks_are_looked_at_between_instants_too():
    declared = problem(
        al.peak("speed").mean <= 0.62, minimize=al.objectives.effort("x_torque"), steps=3, free=4, t_final=2.0
    )
    found = transcribe(declared)
    start = declared.placements.vector("initial")
    excess = excess_between(found, start, reference(found, start, 40))
    points = al.BSpline(np.concatenate([[0.0, 0.0], np.linspace(0.2, 0.8, 4), [1.0, 1.0]])[:, None], start=(), end=())
    speed = points.derivative(1).sampled(np.linspace(0.0, 1.0, 121), 0.0, 2.0)
    peak = float(np.abs(speed).max())
    assert peak > float(np.abs(speed[::40]).max())
    assert excess.where == "speed"
    np.testing.assert_allclose(excess.shifts[0], [peak - 0.62], rtol=1e-12)
    assert excess.worst == pytest.approx((peak - 0.62) / 0.62)
    assert is_over_time(declared.constraints[0])


def test_an_equality_along_a_path_that_breaks_between_instants_is_reported():
    # Two instants, between which the cart is anywhere else.
    exact = problem(al.path("speed").mean.equals(0.0), minimize=al.objectives.effort("x_torque"), steps=1)
    solution = al.solve(exact, throw=False)
    assert not solution.ok
    assert solution.certificate.between.name == "speed"


def test_an_interruption_while_limits_are_tightened_is_not_swallowed(monkeypatch):
    solve, calls = FilterSQP.solve, []

    def interrupted(self, program, **options):
        calls.append(program)
        outcome = solve(self, program, **options)
        return outcome if len(calls) == 1 else outcome.__class__(**(vars(outcome) | {"status": Status.INTERRUPTED}))

    monkeypatch.setattr(FilterSQP, "solve", interrupted)
    with pytest.raises(KeyboardInterrupt):
        al.solve(problem(steps=5))
    assert len(calls) == 2


class Softening(al.System):
    """`ẍ = u - x + x³`: from some starts on it escapes in finite time."""

    states = ("x", "v")
    start: al.Number = 0.0

    def initial(self):
        return {"x": self.start, "v": 0.0}

    def rhs(self, t, z, u):
        del t
        return z.v, u - z.x + z.x**3

    def outputs(self, t, z, u):
        del t, u
        return {"x": z.x}


def test_simulations_that_come_to_no_end_make_no_design():
    force = al.BSpline(al.Decision(np.full(4, 30.0), 20.0, 40.0))
    escaping = al.Problem(
        Softening(start=al.Uniform(0.5, half_width=0.1)),
        grid=al.Grid(4.0, 40),
        inputs={"u": force},
        minimize=al.terminal("x").variance,
        expansion=al.Expansion(order=2),
    )
    with pytest.raises(al.SimulationError, match="not finite"):
        al.solve(escaping)


class Flat(al.System):
    """A number that stays what it is, and an output that is flat about the start."""

    states = ("k",)
    k: al.Number = 0.0

    def initial(self):
        return {"k": self.k}

    def rhs(self, t, z):
        del t
        return (0.0 * z.k,)

    def outputs(self, t, z):
        del t
        return {"over": jnp.maximum(z.k - 1.5, 0.0), "k": z.k, "fixed": 2.0 + 0.0 * z.k}


def flat(constraint):
    return al.Problem(
        Flat(k=al.Decision(0.5, 0.0, 4.0)),
        grid=al.Grid(1.0, 2),
        minimize=al.terminal("k").mean,
        subject_to=[constraint],
    )


def test_a_constraint_that_is_flat_at_the_start_alone_is_not_refused():
    # The solver may not find the way there, but it is not told that there is none.
    assert al.solve(flat(al.terminal("over").mean >= 0.2), start={"k": 2.0}).objective == pytest.approx(1.7)
    with pytest.raises(al.ProblemError, match="whatever the decisions are"):
        al.solve(flat(al.terminal("fixed").mean <= 1.0))


def test_arguments_that_make_no_sense_are_refused_in_words():
    declared = problem()
    for options, words in [
        ({"between": 0}, "whole number of at least 1; received 0"),
        ({"between": 2.5}, "received 2.5"),
        ({"start": {"t_final": "soon"}}, r"'t_final': expected finite numbers of shape \(\); received 'soon'"),
        ({"start": {"t_final": np.nan}}, "'t_final': expected finite numbers of shape .*; received nan"),
        ({"warm_start": {"t_final": 1.0}}, "expected a Solution as `warm_start`; received dict"),
    ]:
        with pytest.raises(al.ProblemError, match=words):
            al.solve(declared, **options)


def test_a_solution_on_another_grid_is_a_start():
    coarse = al.solve(problem(steps=12))
    fine = al.solve(problem(steps=24), warm_start=coarse)
    assert fine.objective == pytest.approx(coarse.objective, rel=0.02)


def test_a_problem_whose_numbers_were_changed_in_place_is_transcribed_anew():
    declared = problem()
    before = al.solve(declared, between=1).objective
    declared.system.motion.end[0][...] = 2.0
    after = al.solve(declared, between=1).objective
    # Twice as far takes √2 times as long.
    assert after == pytest.approx(np.sqrt(2) * before, rel=1e-4)
