"""A delay equation as six phases that are linked end to start, with limits on control and state together.

Göllmann, Kern and Maurer (2009): x' = x(t - 1) u(t - 2) on [0, 6]; Betts, problem 10.50: J = 3.10812211.
"""

import pytest

import aleator as al

PHASES = range(1, 7)
LATER = range(2, 7)


class Chain(al.System):
    """The phases side by side over one second: `x_i` starts at `s_i`, and the first at 1."""

    states = tuple(f"x{i}" for i in PHASES)

    s2: al.Number
    s3: al.Number
    s4: al.Number
    s5: al.Number
    s6: al.Number

    def initial(self):
        return {"x1": 1.0, **{f"x{i}": getattr(self, f"s{i}") for i in LATER}}

    def rhs(self, t, z, u1, u2, u3, u4, u5, u6):
        # Before zero x is 1 and u is 0.
        return 0.0, 0.0, z.x2 * u1, z.x3 * u2, z.x4 * u3, z.x5 * u4

    def outputs(self, t, z, u1, u2, u3, u4, u5, u6):
        controls = (u1, u2, u3, u4, u5, u6)
        sums = {f"sum{i}": x + u for i, x, u in zip(PHASES, z, controls, strict=True)}
        return {**z._asdict(), **sums, "cost": sum(one**2 for one in (*z, *controls))}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("way", "error"),
    [(al.Simultaneous(al.schemes.Radau(3)), 1e-5), (al.Sequential(), 1e-3)],
    ids=["collocated", "shot"],
)
def test_linked_phases_are_the_delay_equation(way, error):
    problem = al.Problem(
        Chain(**{f"s{i}": al.Decision(1.0, -5.0, 5.0) for i in LATER}),
        grid=al.Grid(1.0, 20),
        inputs={f"u{i}": al.Control(0.0, -5.0, 5.0, degree=1) for i in PHASES},
        minimize=al.integral("cost").mean,
        subject_to=[
            *((al.terminal(f"x{i - 1}").mean - al.value(f"s{i}")).equals(0.0) for i in LATER),
            *(al.path(f"sum{i}").at_least(0.3) for i in PHASES),
        ],
    )
    solution = al.solve(problem, transcription=way)
    assert solution.objective == pytest.approx(3.10812211, rel=error)
    assert solution.decisions["s2"] == pytest.approx(1.0, abs=1e-6)
