"""A delay equation over six units of time, with limits on control and state together, written in two ways.

Göllmann, Kern and Maurer (2009): x' = x(t - 1) u(t - 2) on [0, 6]; Betts (2010), problem 10.50: J = 3.10812211. Before
zero x is 1 and u is 0; x + u >= 0.3; the cost is the integral of x² + u².
"""

from typing import Any, ClassVar

import pytest

import aleator as al

UNITS = range(1, 7)
LATER = range(2, 7)


class Chain(al.System):
    """All units of time side by side: `x_i` starts at `s_i`, and the first at 1."""

    states = tuple(f"x{i}" for i in UNITS)

    s2: al.Number
    s3: al.Number
    s4: al.Number
    s5: al.Number
    s6: al.Number

    def initial(self):
        return {"x1": 1.0, **{f"x{i}": getattr(self, f"s{i}") for i in LATER}}

    def rhs(self, t, z, u1, u2, u3, u4, u5, u6):
        return 0.0, 0.0, z.x2 * u1, z.x3 * u2, z.x4 * u3, z.x5 * u4

    def outputs(self, t, z, u1, u2, u3, u4, u5, u6):
        controls = (u1, u2, u3, u4, u5, u6)
        sums = {f"sum{i}": x + u for i, x, u in zip(UNITS, z, controls, strict=True)}
        return {**z._asdict(), **sums, "cost": sum(one**2 for one in (*z, *controls))}


def side_by_side() -> al.Problem:
    """Links are limits, of decided starts."""
    return al.Problem(
        Chain(**{f"s{i}": al.Decision(1.0, -5.0, 5.0) for i in LATER}),
        grid=al.Grid(1.0, 20),
        inputs={f"u{i}": al.Control(0.0, -5.0, 5.0, degree=1) for i in UNITS},
        minimize=al.integral("cost").mean,
        subject_to=[
            *((al.terminal(f"x{i - 1}").mean - al.value(f"s{i}")).equals(0.0) for i in LATER),
            *(al.path(f"sum{i}").at_least(0.3) for i in UNITS),
        ],
    )


def delayed(unit: int) -> al.System:
    """A unit of time, beside all before it, which begin anew: `x1` ... and `u1` ... are x and u in those so far."""

    class Delayed(al.System):
        states = tuple(f"x{i}" for i in range(1, unit + 1))
        further_inputs: ClassVar = tuple(f"u{i}" for i in range(1, unit + 1))

        def initial(self):
            return {"x1": 1.0}

        def rhs(self, t, z, **u):
            return tuple(z[i - 2] * u[f"u{i - 2}"] if i > 2 else 0.0 * z[0] for i in range(1, unit + 1))

        def outputs(self, t, z, **u):
            x, now = z[-1], u[f"u{unit}"]
            return {"cost": x**2 + now**2, "sum": x + now}

    return Delayed()


def one_after_the_other() -> al.Problem:
    """Phases, of which each takes the controls of all before it."""
    inputs = {f"u{i}": al.Control(0.0, -5.0, 5.0, degree=1) for i in UNITS}
    phases = {
        f"unit{i}": al.Phase(
            delayed(i),
            al.Grid(1.0, 20),
            {name: inputs[name] for name in list(inputs)[:i]},
            subject_to=[al.path("sum").at_least(0.3)],
        )
        for i in UNITS
    }

    def shift(self: Any, t: Any, z: Any) -> dict[str, Any]:
        return {"x1": 1.0} | {f"x{i + 2}": value for i, value in enumerate(z)}

    first, *others = (al.integral("cost", phase=name).mean for name in phases)
    linked = al.Phases(**phases, link=dict.fromkeys(list(phases)[1:], shift))
    return al.Problem(linked, minimize=sum(others, start=first))


@pytest.mark.slow
@pytest.mark.parametrize("declared", [side_by_side, one_after_the_other])
@pytest.mark.parametrize(
    ("way", "error"),
    [(al.Simultaneous(al.schemes.Radau(3)), 1e-5), (al.Sequential(), 1e-3)],
    ids=["collocated", "shot"],
)
def test_a_delay_equation_costs_what_betts_publishes(declared, way, error):
    solution = al.solve(declared(), transcription=way)
    assert solution.ok, solution
    assert solution.objective == pytest.approx(3.10812211, rel=error)
    # The state of the second unit of time begins at 1, as that of the first one ends.
    states = solution.states
    begins = states["x2"] if "x2" in states else states["unit2.x2"]
    assert begins["mean"].values[0] == pytest.approx(1.0, abs=1e-6)
