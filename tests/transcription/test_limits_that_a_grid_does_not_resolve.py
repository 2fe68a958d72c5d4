"""A limit that holds on both grids by luck, as with a pulse between the steps, makes no design."""

import warnings
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import aleator as al
from aleator.nlp import Status

HEIGHT, WIDTH, DAMPING, END = 1e4, 0.0038, 0.4, 4.0
"""Of a pulse of force per mass (N/kg, s); of the damper (1/s); of time (s)."""


class Struck(al.System):
    """A mass on a spring that a narrow pulse strikes."""

    states = ("x", "v")
    stiffness: Any
    centre: float = 1.0
    width: float = WIDTH

    def rhs(self, t, z):
        pulse = HEIGHT * jnp.exp(-0.5 * ((t - self.centre) / self.width) ** 2)
        return z.v, pulse - DAMPING * z.v - self.stiffness * z.x

    def outputs(self, t, z):
        return {"x": z.x}


def struck(steps, centre, limits, start=60.0):
    return al.Problem(
        Struck(al.Uniform(al.Decision(start, 4.0, 400.0), half_width=1.0), centre),
        grid=al.Grid(END, steps),
        minimize=al.value("stiffness.mean"),
        subject_to=limits,
    )


def solved(problem, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return al.solve(problem, throw=False, **options)


def moved(stiffness, centre):
    """The motion by SciPy, which no step carries past the pulse."""
    return solve_ivp(
        lambda t, z: [
            z[1],
            HEIGHT * np.exp(-0.5 * ((t - centre) / WIDTH) ** 2) - DAMPING * z[1] - stiffness * z[0],
        ],
        (0.0, END),
        [0.0, 0.0],
        t_eval=np.linspace(0.0, END, 4001),
        max_step=WIDTH / 4,
        rtol=1e-9,
        atol=1e-9,
    ).y[0]


END_LIMIT = al.terminal("x").at_most(5.0).named("end")


@pytest.mark.parametrize(("steps", "centre"), [(40, 1.0042), (40, 1.0125), (100, 1.0217)])
def test_a_pulse_between_the_steps_is_no_solution_though_the_limit_holds_by_luck(steps, centre):
    solution = solved(struck(steps, centre, [END_LIMIT]))
    told = solution.constraints[0].values
    true = moved(float(solution.vector[0]), centre)[-1]
    # Not a part of the truth is seen.
    assert abs(float(np.max(told)) - true) > 0.25 * max(5.0, abs(true))
    assert solution.status is Status.COARSE
    error = solution.certificate.grid_error
    assert error is not None
    assert not error.broken
    assert "'end'" in solution.why()
    assert "do not tell whether it holds" in solution.why()
    assert "refine=True" in solution.why()


def test_refining_resolves_the_pulse_and_the_limit_holds_in_truth():
    solution = solved(struck(40, 1.0125, [END_LIMIT]), refine=True)
    assert solution.ok
    nodes, weights = np.polynomial.legendre.leggauss(5)
    true = weights @ [moved(float(solution.vector[0]) + side, 1.0125)[-1] for side in nodes] / 2
    assert true < 5.0
    assert float(np.max(solution.constraints[0].values)) == pytest.approx(true, rel=1e-2)


def test_a_pulse_between_the_steps_of_the_finer_grid_too_is_seen_by_other_instants():
    # On 200 instants nothing happens at all.
    narrow = al.Problem(
        Struck(al.Uniform(al.Decision(60.0, 4.0, 400.0), half_width=1.0), 1.0125, 1e-3),
        grid=al.Grid(END, 100),
        minimize=al.value("stiffness.mean"),
        subject_to=[al.rms("x").at_most(0.2).named("ride")],
    )
    solution = solved(narrow)
    assert solution.status in (Status.COARSE, Status.INFEASIBLE)
    assert "do not tell whether it holds" in solution.why() or "exceeds its bound" in solution.why()


def test_a_limit_that_only_the_grid_breaks_is_told_to_be_one_of_the_grid():
    # An instant in the pulse makes it stronger, so that no spring seems stiff enough.
    limit = al.rms("x").at_most(2.5).named("ride")
    solution = solved(struck(40, 1.0, [limit]))
    assert solution.status is Status.INFEASIBLE
    for stiffness in (399.0, 401.0):
        assert np.sqrt(np.mean(moved(stiffness, 1.0) ** 2)) < 2.5
    assert "Perhaps for its grid" in solution.why()
    assert "'ride'" in solution.why()


class Decaying(al.System):
    """`x' = -rate x`, and whether more than a second has passed."""

    states = ("x",)
    rate: Any

    def initial(self):
        return {"x": 1.0}

    def rhs(self, t, z):
        return (-self.rate * z.x,)

    def outputs(self, t, z):
        return {"x": z.x, "late": jnp.where(t > 1.0, 1.0, 0.0) * z.x}


@pytest.mark.parametrize(
    "limits",
    [
        [al.terminal("x").at_most(0.05)],
        [al.path("x").at_most(1.5), al.terminal("x").at_least(0.0)],
        [al.path("late").at_most(0.7)],
        [al.terminal("x").within(0.01, 100.0)],
        [al.peak("x").at_most(1.2)],
    ],
    ids=["active", "far", "jump at an instant", "wide", "peak"],
)
@pytest.mark.parametrize("steps", [10, 14, 100])
def test_a_coarse_grid_that_resolves_its_limits_is_usable(limits, steps):
    problem = al.Problem(
        Decaying(al.Uniform(al.Decision(2.0, 0.5, 4.0), half_width=0.05)),
        grid=al.Grid(2.0, steps),
        minimize=al.value("rate.mean"),
        subject_to=limits,
    )
    solution = solved(problem)
    error = solution.certificate.grid_error
    assert error is not None
    assert not error.unresolved
    assert solution.ok
