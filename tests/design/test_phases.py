"""Motions in phases, against SciPy, against one phase, and against a published value."""

from functools import cache
from typing import ClassVar

import numpy as np
import pytest
import scipy

import aleator as al
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


def staging(burn=2.0, steps=40, **options):
    """The height at the end of the second stage's burn, whose duration is decided."""
    flight = al.Phases(
        first=al.Phase(
            Rocket(al.Uniform(500.0, half_width=50.0), 2.0, BURNT), al.Grid(until="burnout", at_most=20.0, steps=steps)
        ),
        second=al.Phase(Rocket(200.0, 0.5, 1.0), al.Grid(al.Decision(burn, 1.0, 6.0), steps)),
        link={"second": lambda self, t, z: {"m": z.m - HULL}},
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
    burn, speed = al.value("second.t_final"), al.terminal("v")
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


def test_instants_of_phases_stand_one_after_the_other():
    found = staged()
    burn = found.decisions["second.t_final"]
    assert found.instants[[0, 40, 41, 81]] == pytest.approx([0.0, 5.0, 5.0, 5.0 + burn], rel=1e-8)
    assert found.outputs["second.m"]["time"].values[[0, -1]] == pytest.approx([5.0, 5.0 + burn], rel=1e-8)
    assert found.states["second.m"]["mean"].values[0] == pytest.approx(BURNT - HULL, rel=1e-8)
    (limit,) = (one for one in found.constraints if one.name == "first.v(t)")
    assert limit.times[[0, -1]] == pytest.approx([0.0, 5.0], rel=1e-8)
    assert list(found.outputs["first.time"]["mean"].values[[0, -1]]) == pytest.approx([0.0, 5.0], rel=1e-8)


def test_fresh_systems_agree_and_figures_show_each_phase():
    found = staged()
    evidence = al.validate(found, samples=200, seed=1)
    assert evidence.agrees, evidence
    end = found.instants[-1]
    figures = found.plot.band("first.v"), evidence.plot.band("first.v"), found.plot.histories("second.m")
    for figure, span in zip(figures, [(0.0, 5.0), (0.0, 5.0), (5.0, end)], strict=True):
        shown = np.concatenate([np.asarray(one.x, float) for one in figure.data if one.x[0] is not None])
        assert (np.nanmin(shown), np.nanmax(shown)) == pytest.approx(span, rel=1e-6)


class Lander(al.System):
    """A fall that is braked until it rests; the engine burns a little at first, then not, then fully."""

    states = ("h", "v", "m")
    thrust: al.Number
    throttle: al.Number = 1.0
    events: ClassVar = {"rest": al.Event(lambda self, t, z: z.v, direction=1)}

    def initial(self):
        return {"h": 1000.0, "v": -20.0, "m": 10.0}

    def burn(self, z, throttle):
        force = self.thrust * throttle
        return z.v, force / z.m - 1.6, -force / 2000.0

    def rhs(self, t, z):
        return self.burn(z, self.throttle)

    def outputs(self, t, z):
        return {"h": z.h, "m": z.m}


class Switched(Lander):
    """The same in one phase, whose throttle switches at decided times."""

    def rhs(self, t, z, throttle):
        return self.burn(z, throttle)


def test_a_coast_between_two_burns_is_the_same_design_in_three_phases_and_in_one():
    thrust, coast = al.Normal(60.0, 0.5).shared("thrust"), al.Decision(8.0, 1.0, 20.0)
    limits = {"minimize": -al.terminal("m").mean, "subject_to": [al.terminal("h").at_least(10.0, sigmas=3)]}
    phases = al.Phases(
        turn=al.Phase(Lander(thrust, 0.1), al.Grid(1.0, 5)),
        coast=al.Phase(Lander(thrust, 0.0), al.Grid(coast, 20)),
        brake=al.Phase(Lander(thrust), al.Grid(until="rest", at_most=30.0, steps=40)),
    )
    three = al.solve(al.Problem(phases, **limits))
    throttle = al.StepFunction([1.0, al.Decision(9.0, 2.0, 21.0)], [0.1, 0.0, 1.0])
    grid = al.Grid(until="rest", at_most=60.0, steps=100)
    one = al.solve(al.Problem(Switched(thrust), grid=grid, inputs={"throttle": throttle}, **limits))
    assert three.ok, three
    assert one.ok, one
    assert three.objective == pytest.approx(one.objective, rel=1e-8)
    (duration,), (switch,) = three.decisions.values(), one.decisions.values()
    assert 1.0 + duration == pytest.approx(switch, rel=1e-6)
    assert three.multiplier("brake.h") == pytest.approx(one.multiplier("h"), rel=1e-6)


def delayed(part):
    """The unit of time number `part` of `x'(t) = x(t - 1) u(t - 2)`, beside all before it, which begin anew.

    `x1` … are what `x` is in the units of time so far; `u1` … the inputs there, zero before.
    """

    class Delayed(al.System):
        states = tuple(f"x{i}" for i in range(1, part + 1))

        def initial(self):
            return {"x1": 1.0}

        def rhs(self, t, z, **u):
            return tuple(z[i - 2] * u[f"u{i - 2}"] if i > 2 else 0.0 * z[0] for i in range(1, part + 1))

        def outputs(self, t, z, **u):
            x, now = z[-1], u[f"u{part}"]
            return {"cost": x**2 + now**2, "sum": x + now}

        further_inputs: ClassVar = tuple(f"u{i}" for i in range(1, part + 1))

    return Delayed()


def test_a_chain_of_delays_costs_what_betts_publishes():
    inputs = {f"u{i}": al.Control(0.0, degree=1) for i in range(1, 7)}
    parts = {
        f"part{i}": al.Phase(
            delayed(i),
            al.Grid(1.0, 20),
            {name: inputs[name] for name in list(inputs)[:i]},
            subject_to=[al.path("sum").mean >= 0.3],
        )
        for i in range(1, 7)
    }

    def shift(self, t, z):
        return {"x1": 1.0} | {f"x{i + 2}": value for i, value in enumerate(z)}

    phases = al.Phases(**parts, link=dict.fromkeys(list(parts)[1:], shift))
    cost = sum((al.integral("cost", phase=name).mean for name in parts), start=al.as_expression(0.0))
    found = al.solve(al.Problem(phases, minimize=cost), between=1)
    assert found.status is al.Status.SOLVED
    # Betts (2010), 10.50, as limits at 20 instants of each unit of time and straight lines between allow.
    assert found.objective == pytest.approx(3.10812211, rel=1e-3)
