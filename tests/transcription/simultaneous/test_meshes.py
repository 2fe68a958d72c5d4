"""Meshes are refined until their errors are as small as asked: orders are raised, and intervals that err divided."""

import jax.numpy as jnp
import numpy as np
import pytest
from collocated_problems import VanDerPol

import aleator as al
from aleator.trajectories import piecewise_in
from aleator.transcription import transcribe
from aleator.transcription.simultaneous._refinement import Drift, Goal, refinement
from aleator.transcription.simultaneous._tiles import EVALUATE

# --- What is refined, and how ----------------------------------------------------------------------------------------

RADAU, ASKED = tuple(al.schemes.Radau(stages) for stages in range(3, 11)), 1e-6


def refined(errors, ratios, schemes=RADAU, scheme=RADAU[0]):
    drift = Drift(np.array(errors)[None, :, None], np.array(ratios)[None, :, None])
    scheme, (parts,) = refinement(Goal(ASKED, schemes), scheme, [drift])
    return scheme.stages, parts.tolist()


def test_orders_are_raised_where_states_are_smooth_and_intervals_divided_where_they_are_not():
    # Twice 1e-4 falls below 1e-6 by three stages that take a tenth each: 6 points an interval, not 4 times 3.
    assert refined([1e-4] * 5, [0.1] * 5) == (6, [1] * 5)
    for ratio in (0.3, 1.0):
        assert refined([1e-8] * 9 + [1e-4], [0.1] * 9 + [ratio]) == (3, [1] * 9 + [4])
    # Beside a kink order and division go together.
    assert refined([1e-4] * 9 + [1e-2], [0.1] * 9 + [1.0]) == (6, [1] * 9 + [5])
    # Stages are never taken away, and stay where no more are allowed.
    assert refined([1e-4], [0.1], scheme=RADAU[-1])[0] == 10
    assert refined([1e-4], [0.1], schemes=RADAU[:1])[0] == 3


# --- Solutions on meshes ---------------------------------------------------------------------------------------------


class Spring(al.System):
    """x = cos(√k t), and w = ∫ |t - kink| dt."""

    states = ("x", "v", "w")

    stiffness: al.Number
    kink: al.Number = 0.0
    tall: al.Number = 0.0

    def rhs(self, t, z):
        return z.v, -self.stiffness * z.x, self.tall * jnp.abs(t - self.kink)

    def outputs(self, t, z):
        return {"x": z.x, "w": z.w}

    def initial(self):
        return {"x": 1.0}


def stiffest(steps, most=2.0, kink=0.0, tall=0.0):
    spring = Spring(al.Decision(0.5 * most, 0.01 * most, most), kink, tall)
    return al.Problem(spring, grid=al.Grid(5.0, steps), minimize=-al.value("stiffness") + 0.0 * al.terminal("w").mean)


def test_intervals_are_divided_at_a_kink_and_nowhere_else():
    """Between kinks the push is a polynomial, which every scheme follows exactly."""
    kink, end = 0.73, 5.0
    way = al.Simultaneous(al.schemes.Radau(3), error=ASKED, most_stages=10)
    solution = al.solve(stiffest(10, most=1e-6, kink=kink, tall=1.0), transcription=way)
    assert solution.mesh.is_met
    assert solution.mesh.scheme == al.schemes.Radau(3)
    nodes = solution.mesh.nodes
    lengths = np.diff(nodes)
    assert lengths[(nodes[:-1] < kink) & (kink < nodes[1:])] < 0.5 / 8
    np.testing.assert_allclose(lengths[(nodes[1:] <= 0.5) | (nodes[:-1] >= 1.0)], 0.5)
    assert solution.mesh_states["w"][0, -1] == pytest.approx((kink**2 + (end - kink) ** 2) / 2, rel=20 * ASKED)


def test_a_mesh_that_does_not_converge_is_told_with_its_place(monkeypatch):
    monkeypatch.setattr("aleator.transcription.simultaneous._transcribed._MOST_MESHES", 2)
    with pytest.warns(al.GridWarning, match=r"mesh does not reach .* from t = .* where 1e-09 is asked"):
        solution = al.solve(stiffest(5), transcription=al.Simultaneous(error=1e-9))
    assert len(solution.meshes) == 2
    assert not solution.meshes[-1].is_met


def test_a_control_follows_a_mesh_that_is_refined_for_which_nothing_is_compiled_again():
    problem = al.Problem(
        VanDerPol(),
        grid=al.Grid(10.0, 30),
        inputs={"u": al.Control(0.0, -1.0, 1.0)},
        minimize=al.integral("cost").mean,
    )
    first = transcribe(problem, al.Simultaneous(error=1e-7))
    outcome = al.solvers.Ipopt().solve(first.program)
    before = EVALUATE.compilations
    finer, point = first.refined(outcome.point)
    assert EVALUATE.compilations == before
    (control,) = piecewise_in(finer.problem.simulation)
    assert control.nodes == pytest.approx(finer.meshes_at(point)[-1].nodes / 10.0)
    assert len(control.nodes) > 31
    # The same function of time as before.
    middles = (np.array(control.nodes[1:]) + control.nodes[:-1]) / 2
    expected = first.decisions(outcome.point)[(30 * middles).astype(int)]
    assert finer.decisions(point) == pytest.approx(expected, abs=1e-9)
