"""Orders of schemes are raised where states are smooth, and intervals divided where they are not."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.transcription import transcribe
from aleator.transcription.simultaneous._mesh_error import Drift
from aleator.transcription.simultaneous._refinement import Goal, refinement
from aleator.transcription.simultaneous._tiles import EVALUATE

RADAU = tuple(al.schemes.Radau(stages) for stages in range(3, 11))
ASKED = 1e-6


def drift(errors: list[float], ratios: list[float]) -> Drift:
    return Drift(np.array(errors)[None, :, None], np.array(ratios)[None, :, None])


def test_where_all_states_are_smooth_the_order_is_raised_and_nothing_is_divided():
    """Twice 1e-4 falls below 1e-6 by three stages that take a tenth each: 6 points an interval, not 4 times 3."""
    scheme, parts = refinement(Goal(ASKED, RADAU), RADAU[0], drift([1e-4] * 5, [0.1] * 5))
    assert scheme == al.schemes.Radau(6)
    assert parts.tolist() == [1] * 5


@pytest.mark.parametrize("ratio", [0.3, 0.9, 1.0])
def test_one_interval_that_errs_is_divided_alone(ratio):
    scheme, parts = refinement(Goal(ASKED, RADAU), RADAU[0], drift([1e-8] * 9 + [1e-4], [0.1] * 9 + [ratio]))
    assert scheme == RADAU[0]
    assert parts.tolist() == [1] * 9 + [4]


def test_beside_a_kink_order_and_division_go_together():
    scheme, parts = refinement(Goal(ASKED, RADAU), RADAU[0], drift([1e-4] * 9 + [1e-2], [0.1] * 9 + [1.0]))
    assert scheme == al.schemes.Radau(6)
    assert parts.tolist() == [1] * 9 + [5]


def test_stages_are_never_taken_away_and_stay_where_no_more_are_allowed():
    goal = Goal(ASKED, RADAU)
    assert refinement(goal, RADAU[-1], drift([1e-4], [0.1]))[0] == RADAU[-1]
    assert refinement(Goal(ASKED, RADAU[:1]), RADAU[0], drift([1e-4], [0.1]))[0] == RADAU[0]


class Spring(al.System):
    """x = cos(√k t)."""

    states = ("x", "v")

    stiffness: Any = al.Decision(1.0, 0.5, 2.0)

    def rhs(self, t, z):
        return z.v, -self.stiffness * z.x

    def outputs(self, t, z):
        return {"x": z.x}

    def initial(self):
        return {"x": 1.0}


class Pushed(al.System):
    """w = ∫ |t - kink| dt, and a number that nothing depends on."""

    states = ("w",)

    kink: float = 0.73
    idle: Any = al.Decision(0.1, -1.0, 1.0)

    def rhs(self, t, z):
        return (jnp.abs(t - self.kink),)

    def outputs(self, t, z):
        return {"w": z.w}


def stiffest(steps: int) -> al.Problem:
    return al.Problem(Spring(), grid=al.Grid(5.0, steps), minimize=-al.value("stiffness"))


@pytest.mark.parametrize("scheme", [al.schemes.Radau(3), al.schemes.GaussLegendre(2)], ids=str)
def test_an_oscillation_is_followed_by_few_intervals_of_high_order(scheme):
    asked = 1e-9
    raised = al.solve(stiffest(5), transcription=al.Simultaneous(scheme, error=asked, most_stages=12))
    divided = al.solve(stiffest(5), transcription=al.Simultaneous(scheme, error=asked))
    assert type(raised.mesh.scheme) is type(scheme)
    stages = [one.scheme.stages for one in raised.meshes]
    assert stages[0] == scheme.stages < stages[-1] <= 12
    assert stages == sorted(stages)
    assert raised.mesh.is_met
    for one in (raised, divided):
        np.testing.assert_allclose(one.states["x"][0], np.cos(np.sqrt(2.0) * one.states.times), atol=20 * asked)
    assert {one.scheme for one in divided.meshes} == {scheme}
    assert len(raised.states.times) < len(divided.states.times) / 3


def test_intervals_are_divided_at_a_kink_and_nowhere_else():
    """Between kinks the push is a polynomial, which every scheme follows exactly."""
    kink, end, asked = Pushed.kink, 5.0, 1e-6
    problem = al.Problem(Pushed(), grid=al.Grid(end, 10), minimize=al.terminal("w").mean - al.value("idle"))
    solution = al.solve(problem, transcription=al.Simultaneous(al.schemes.Radau(3), error=asked, most_stages=10))
    assert solution.mesh.is_met
    assert solution.mesh.scheme == al.schemes.Radau(3)
    nodes = solution.mesh.nodes
    lengths = np.diff(nodes)
    assert lengths[(nodes[:-1] < kink) & (kink < nodes[1:])] < 0.5 / 8
    np.testing.assert_allclose(lengths[(nodes[1:] <= 0.5) | (nodes[:-1] >= 1.0)], 0.5)
    exact = (kink**2 + (end - kink) ** 2) / 2
    assert solution.states["w"][0, -1] == pytest.approx(exact, rel=20 * asked)


def test_what_is_compiled_serves_meshes_of_higher_order():
    first = transcribe(stiffest(5), al.Simultaneous(al.schemes.Radau(3), error=1e-9, most_stages=10))
    outcome = al.solvers.Ipopt().solve(first.program)
    before = EVALUATE.compilations
    refined = first.refined(outcome.point)
    assert refined is not None
    assert refined[0].meshes_at(refined[1])[-1].scheme != al.schemes.Radau(3)
    # Signals, of which there are others at other points.
    assert EVALUATE.compilations - before == 1


@pytest.mark.parametrize("most", [0, -3, 2.5, "8", True, 3, 2, 13])
def test_more_stages_are_a_whole_number_that_the_scheme_can_have(most):
    with pytest.raises(al.ProblemError, match="stages"):
        al.Simultaneous(al.schemes.Radau(3), error=1e-6, most_stages=most)


def test_a_scheme_without_stages_to_choose_and_a_mesh_that_is_not_refined_are_given_no_more():
    with pytest.raises(al.ProblemError, match=r"expected a scheme whose stages can be raised to 8.*HermiteSimpson"):
        al.Simultaneous(error=1e-6, most_stages=8)
    with pytest.raises(al.ProblemError, match="expected an error to refine them for"):
        al.Simultaneous(al.schemes.Radau(3), most_stages=8)
