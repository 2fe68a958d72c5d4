"""A delay equation over six units of time, with limits on control and state together.

Göllmann, Kern and Maurer (2009): x' = x(t - 1) u(t - 2) on [0, 6]; Betts (2010), problem 10.50: J = 3.10812211. Before
zero x is 1 and u is 0; x + u >= 0.3; the cost is the integral of x² + u².
"""

from typing import Any, ClassVar

import pytest

import aleator as al

UNITS = range(1, 7)


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
def test_a_delay_equation_costs_what_betts_publishes():
    solution = al.solve(one_after_the_other(), transcription=al.Simultaneous(al.schemes.Radau(3)))
    assert solution.ok, solution
    assert solution.objective == pytest.approx(3.10812211, rel=1e-5)
    # The state of the second unit of time begins at 1, as that of the first one ends.
    assert solution.states["unit2.x2"]["mean"].values[0] == pytest.approx(1.0, abs=1e-6)
