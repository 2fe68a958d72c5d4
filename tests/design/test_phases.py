"""Motions in phases, against SciPy, against one phase, and against a published value."""

from functools import cache
from typing import ClassVar

import numpy as np
import pytest
import scipy

import aleator as al
from aleator.reporting import dataset
from aleator.transcription import transcribe
from zoo import G


class Rocket(al.System):
    """A rocket that burns its fuel at a constant flow, with drag; its stage has a dry mass."""

    states = ("h", "v", "m")
    thrust: al.Number
    flow: al.Number = 0.0
    dry: al.Number = 0.0
    drag: al.Number = 0.01
    events: ClassVar = {
        "burnout": al.Event(lambda self, t, z: z.m - self.dry, direction=-1),
        "top": al.Event(lambda self, t, z: z.v, direction=-1),
        "rest": al.Event(lambda self, t, z: z.v, direction=1),
    }

    def initial(self):
        return {"m": 20.0}

    def rhs(self, t, z):
        return z.v, (self.thrust - self.drag * z.v * abs(z.v)) / z.m - G, -self.flow

    def outputs(self, t, z):
        return {"h": z.h, "v": z.v, "m": z.m}


# The mass of the first stage's hull, which is dropped when its fuel is burnt.
HULL, BURNT = 3.0, 10.0


def dropped(self, t, z):
    return {"m": z.m - HULL}


def staging(burn=2.0, steps=40, **options):
    """The height at the end of the second stage's burn, whose duration is decided."""
    flight = al.Phases(
        first=al.Phase(
            Rocket(al.Uniform(500.0, half_width=50.0), 2.0, BURNT), al.Grid(until="burnout", at_most=20.0, steps=steps)
        ),
        second=al.Phase(Rocket(200.0, 0.5, 1.0), al.Grid(al.Decision(burn, 1.0, 6.0), steps)),
        link={"second": dropped},
    )
    return al.Problem(flight, expansion=al.Expansion(order=4), **options)


def flown(thrust, burn):
    """The states at the end of both stages, by SciPy."""

    def rates(t, z, thrust, flow):
        return [z[1], (thrust - 0.01 * z[1] * abs(z[1])) / z[2] - G, -flow]

    exact = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12}
    first = scipy.integrate.solve_ivp(rates, (0, 5.0), [0.0, 0.0, 20.0], args=(thrust, 2.0), **exact).y[:, -1]
    begun = [first[0], first[1], first[2] - HULL]
    return first, scipy.integrate.solve_ivp(rates, (0, burn), begun, args=(200.0, 0.5), **exact).y[:, -1]


@cache
def staged():
    burn, speed = al.objectives.final_time("second"), al.terminal("v")
    return al.solve(
        staging(
            minimize=burn,
            subject_to=[
                al.terminal("h").at_least(700.0, sigmas=1),
                al.at("burnout", phase="first").mean <= 10.0,
                al.path("v", phase="first").mean <= 200.0,
                speed.mean <= 300.0,
                al.integral("v", phase="first").mean <= 1e3,
            ],
        )
    )


@pytest.mark.slow
def test_two_stages_end_where_scipy_ends_them_one_after_the_other():
    found = staged()
    assert found.ok, found
    burn, height = found.decisions["second.t_final"], found.outputs["second.h"]["systems"]
    for thrust, own, speed in zip(
        found.outputs["second.h"]["first.thrust"].values,
        height.values[:, -1],
        found.outputs["first.v"]["systems"].values[:, -1],
        strict=True,
    ):
        first, second = flown(thrust, burn)
        assert (own, speed) == pytest.approx((second[0], first[1]), rel=1e-8)


@pytest.mark.slow
def test_the_burn_is_the_least_that_reaches_the_height_with_a_margin():
    nodes, weights = np.polynomial.legendre.leggauss(8)

    def margin(burn):
        heights = np.array([flown(500.0 + 50.0 * node, burn)[1][0] for node in nodes])
        mean = weights @ heights / 2
        return mean - np.sqrt(weights @ (heights - mean) ** 2 / 2) - 700.0

    found = staged()
    assert found.decisions["second.t_final"] == pytest.approx(scipy.optimize.brentq(margin, 1.0, 6.0), rel=1e-6)
    # The way of the first stage is the integral of its speed over its own time, which ends when its fuel is burnt.
    heights = np.array([flown(500.0 + 50.0 * node, 1.0)[0][0] for node in nodes])
    assert found.statistics["μ[∫first.v dt]"] == pytest.approx(weights @ heights / 2, rel=1e-8)
    assert found.statistics["μ[t_first.burnout]"] == pytest.approx(5.0, rel=1e-9)


@pytest.mark.slow
def test_instants_of_phases_stand_one_after_the_other():
    found = staged()
    burn = found.decisions["second.t_final"]
    assert found.instants[[0, 40, 41, 81]] == pytest.approx([0.0, 5.0, 5.0, 5.0 + burn], rel=1e-8)
    assert found.outputs["second.m"]["time"].values[[0, -1]] == pytest.approx([5.0, 5.0 + burn], rel=1e-8)
    assert found.states["second.m"]["mean"].values[0] == pytest.approx(BURNT - HULL, rel=1e-8)
    (limit,) = (one for one in found.constraints if one.name == "first.v(t)")
    assert np.asarray(limit.times)[[0, -1]] == pytest.approx([0.0, 5.0], rel=1e-8)
    assert list(found.outputs["first.time"]["mean"].values[[0, -1]]) == pytest.approx([0.0, 5.0], rel=1e-8)
    assert dataset(found)["mean first.v(t)"]["time of first"].values[-1] == pytest.approx(5.0, rel=1e-8)


@pytest.mark.slow
def test_meshes_of_phases_are_refined_until_a_collocated_burn_is_the_simulated_one():
    burn, limit = al.objectives.final_time("second"), al.terminal("h").at_least(700.0, sigmas=1)
    way = al.Simultaneous(al.schemes.Radau(2), error=1e-6, most_stages=6)
    found = al.solve(staging(steps=4, minimize=burn, subject_to=[limit]), transcription=way)
    assert found.ok, found
    assert found.objective == pytest.approx(staged().objective, rel=1e-7)
    assert found.mesh.is_met
    assert len(found.meshes) > 1
    assert found.mesh_states.durations["first"] == pytest.approx(5.0, rel=1e-9)
    assert found.outputs["second.h"]["time"].values[[0, -1]] == pytest.approx([5.0, 5.0 + found.objective], rel=1e-8)
    assert found.states["first.m"]["mean"].values[-1] == pytest.approx(BURNT, rel=1e-9)
    assert dataset(found)["times of states of second"].values[0] == pytest.approx(5.0, rel=1e-9)


@pytest.mark.slow
def test_a_start_is_guessed_phase_by_phase_and_ends_where_the_guess_meets_the_event():
    problem = staging(steps=4, minimize=al.terminal("h").mean)
    first, second = (lambda t: {"h": t, "v": 1.0, "m": 20.0 - 4.0 * t}), {"time": [0, 9], "h": [1, 2], "v": [0, 0]}
    second["m"] = [7.0, 7.0]
    begun = transcribe(problem, al.Simultaneous(guess={"first": first, "second": second}))
    states = begun.states_at(begun.program.start)
    assert states.durations["first"] == pytest.approx(2.5)
    assert states["first.m"][:, -1] == pytest.approx(BURNT)
    assert states["second.h"][0, -1] == pytest.approx(1.0 + 2.0 / 9.0)
    with pytest.raises(al.ProblemError, match=r"each of the phases \['first', 'second'\], by name; received one of no"):
        transcribe(problem, al.Simultaneous(guess=first))


def test_a_simulation_returns_the_outputs_of_each_phase():
    first = al.Phase(Rocket(500.0, 2.0, BURNT), al.Grid(until="burnout", at_most=20.0, steps=40))
    phases = al.Phases(first=first, second=al.Phase(Rocket(200.0, 0.5), al.Grid(2.0, 40)), link={"second": dropped})
    found = al.simulate(phases)
    ends = flown(500.0, 2.0)
    for name, right in zip(("first", "second"), ends, strict=True):
        assert [np.asarray(found[f"{name}.{one}"])[-1] for one in "hvm"] == pytest.approx(right, rel=1e-7)
    with pytest.raises(al.ProblemError, match=r"names of their phases, such as 'first.h'; received \['h'\]"):
        al.simulate(phases, only=["h"])


@pytest.mark.slow
def test_a_phase_that_never_ends_is_named_with_the_states_that_it_begins_with():
    first, fixed = (al.Phase(Rocket(one, 2.0), al.Grid(1.0, 4)) for one in (al.Decision(500.0, 400.0, 600.0), 500.0))
    second = al.Phase(Rocket(0.0), al.Grid(until="top", at_most=1.0, steps=4))
    with pytest.raises(al.SimulationError, match=r"In the phase 'second', Rocket .*never meets 'top'"):
        al.solve(al.Problem(al.Phases(first=first, second=second), minimize=al.terminal("h").mean))
    with pytest.warns(al.SimulationWarning, match=r"In the phase 'second', Rocket .*never meets 'top'"):
        history = al.simulate(al.Phases(first=fixed, second=second))
    assert np.isfinite(history["first.v"]).all()


def test_phases_that_do_not_fit_together_are_refused_where_they_are_declared():
    class Capsule(Rocket):
        states = ("h", "v", "chute")
        events: ClassVar = {}

        def rhs(self, t, z):
            return z.v, -G, 0.0

        def outputs(self, t, z):
            return {"h": z.h}

    first, last = (al.Phase(one, al.Grid(1.0, 2)) for one in (Rocket(300.0), Capsule(al.Decision(1.0, 0.5, 2.0))))

    def problem(minimize=None, link=None, **options):
        links = {"descent": lambda self, t, z: {"chute": 0.0}} | (link or {})
        phases = al.Phases(ascent=first, descent=last, link=links)
        return al.Problem(phases, minimize=al.terminal("h").mean if minimize is None else minimize, **options)

    height = al.path("h")
    for words, make in {
        r"'descent' has the state 'chute', which 'ascent' does not have, and no link gives it: write link=": lambda: (
            al.Problem(al.Phases(ascent=first, descent=last), minimize=al.terminal("h").mean)
        ),
        r"some of the states \('h', 'v', 'chute'\) of Capsule": lambda: problem(
            link={"descent": lambda self, t, z: {"parachute": 0.0}}
        ),
        r"There is no phase 'ascend'; expected one of \['ascent', 'descent'\]. Did you mean 'ascent'": lambda: problem(
            al.terminal("h", phase="ascend").mean
        ),
        "paths of several phases": lambda: problem(subject_to=[height.mean - al.path("h", phase="ascent").mean <= 1.0]),
        r"name of a phase that begins after another, one of \['descent'\]; received 'ascent'": lambda: problem(
            link={"ascent": lambda self, t, z: {}}
        ),
        "grids and inputs of their own": lambda: problem(grid=al.Grid(1.0, 2)),
        "declare the problem again": lambda: problem().on_grid(al.Grid(1.0, 2)),
    }.items():
        with pytest.raises(al.ProblemError, match=words):
            make()
