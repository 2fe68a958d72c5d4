"""Closed loops as simultaneous programs: states by name, and starts that depend on the instant."""

import jax.numpy as jnp
import numpy as np
import pytest
from closed_loops import SliderCrank

import aleator as al
from aleator.transcription import transcribe
from aleator.transcription.simultaneous._guess import state_shapes


class Growing(SliderCrank):
    """A rod that is as long as the time says, so that the start is known only at its instant."""

    def constraint(self, q, t):
        length = self.b + 0.05 * jnp.cos(t)
        return (
            self.a * jnp.cos(q[0]) + length * jnp.cos(q[1]) - q[2],
            self.a * jnp.sin(q[0]) + length * jnp.sin(q[1]),
        )


def turned(model: al.Lagrangian, steps: int) -> al.Problem:
    """Turn the crank of a family of slider-cranks by two radians, as fast at the end as at first."""
    torque = al.BSpline(al.Decision(np.zeros(4), -5.0, 5.0), degree=2)
    start = {"crank": 0.3, "crank_rate": 4.0}
    return al.Problem(
        al.ForwardDynamics(model, torque={"crank_torque": torque}, start=start, guess={"rod": -0.1, "slider": 0.4}),
        grid=al.Grid(0.5, steps),
        minimize=al.integral("constraint_error").mean,
        subject_to=[
            al.terminal("crank").mean.equals(2.3),
            al.terminal("crank_rate").mean.equals(4.0),
        ],
        expansion=al.Expansion(order=1),
    )


@pytest.mark.slow
def test_a_start_that_depends_on_the_instant_is_that_of_the_simulation():
    problem = turned(Growing(rod_mass=al.Uniform(0.5, half_width=0.1)), 4)
    transcribed = transcribe(problem, al.Simultaneous(al.schemes.Radau(1)))
    crank, rod, slider = np.moveaxis(transcribed.layout.view(transcribed.program.start).states[:, 0, :3], 1, 0)
    np.testing.assert_allclose(crank, 0.3, rtol=1e-14)
    np.testing.assert_allclose(np.sin(rod), -0.1 / 0.35 * np.sin(0.3), rtol=1e-9)
    np.testing.assert_allclose(slider, 0.1 * np.cos(0.3) + 0.35 * np.cos(rod), rtol=1e-9)
    tied = transcribed.program.ties.rows
    first = transcribed.program.evaluate(transcribed.program.start).constraints[tied]
    begun = np.isin(transcribed.program.ties.variables, transcribed.layout.numbers.states[:, 0])
    np.testing.assert_allclose(first[begun], 0.0, atol=1e-12)


class Hung(SliderCrank):
    """A pendulum hangs from the slider: two freedoms, of which one is prescribed."""

    names = ("crank", "rod", "slider", "pendulum")

    def kinetic_energy(self, q, v):
        swing = 0.2 * v[3] * jnp.stack([jnp.cos(q[3]), jnp.sin(q[3])])
        moving = swing.at[0].add(v[2])
        return super().kinetic_energy(q, v) + 0.5 * 0.3 * moving @ moving

    def potential_energy(self, q):
        return super().potential_energy(q) - 0.3 * 9.81 * 0.2 * jnp.cos(q[3])


@pytest.mark.slow
def test_the_states_of_driven_loops_are_known_by_name_before_anything_is_simulated():
    """Their start follows from constraints and signals of the first instant."""
    swing, near = al.PowerSeries(start=(0.3, 0.0, 0.0), end=(2.3, 0.0, 0.0)), {"rod": -0.1, "slider": 0.4}
    systems = {
        ("q", "v"): al.HybridDynamics(Hung(), motion={"crank": swing}, guess=near),
        ("q",): al.InverseDynamics(SliderCrank(), motion={"crank": swing}, guess=near),
    }
    for states, system in systems.items():
        problem = al.Problem(system, grid=al.Grid(0.5, 4), minimize=al.terminal("crank").mean)
        shapes = state_shapes(problem)
        assert tuple(shapes) == states
        assert shapes["q"] == (len(system.model.names) - 1,)
