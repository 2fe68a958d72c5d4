"""Meshes of simultaneous programs: estimated errors, and refinement until they are as small as asked."""

import numpy as np
import pytest
from collocated_problems import Cart

import aleator as al
from aleator.transcription.simultaneous._mesh import Mesh
from aleator.transcription.simultaneous._refinement import parts_of

SCHEMES = {
    "Hermite and Simpson": al.schemes.HermiteSimpson(),
    "Radau": al.schemes.Radau(3),
    "Gauss": al.schemes.GaussLegendre(2),
    "segments": al.schemes.MultipleShooting(2),
}


def swing(intervals: int = 8) -> al.Problem:
    """A pendulum on a cart that is let go: nothing but its damping is to be chosen, and that is as strong as may be."""

    class Swing(Cart):
        def initial(self):
            return {"angle": 1.0}

    return al.Problem(
        Swing(damping=al.Decision(0.5, 0.0, 1.0)),
        grid=al.Grid(3.0, intervals),
        inputs={"force": al.Tabulated(np.array([0.0, 3.0]), np.zeros(2))},
        minimize=al.terminal("x").mean - al.value("damping"),
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", SCHEMES)
def test_a_mesh_is_refined_until_its_error_is_what_is_asked(name):
    asked = 1e-5
    way = al.Simultaneous(SCHEMES[name], error=asked)
    solution = al.solve(swing(), transcription=way)
    worst = [one.worst for one in solution.meshes]
    assert worst[-1] <= asked < worst[0]
    assert worst == sorted(worst, reverse=True)
    assert [one.intervals for one in solution.meshes] == sorted(one.intervals for one in solution.meshes)
    assert f"where {asked:.2g} is asked" in str(solution)
    # The integrator, on a grid that is far finer, is the judge.
    exact = al.solve(swing(1200))
    assert solution.objective == pytest.approx(exact.objective, abs=20 * asked)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scheme", "power"), [(al.schemes.HermiteSimpson(), 4.0), (al.schemes.MultipleShooting(1), 5.0)]
)
def test_the_estimated_error_is_that_of_the_states(scheme, power):
    """It is no less than a tenth of the error, and falls by a power: of a collocation scheme that of its stages and one
    more, of segments that of their order and one more.
    """
    found = [al.solve(swing(n), transcription=al.Simultaneous(scheme), accuracy=0.5) for n in (40, 80)]
    exact = al.solve(swing(1600)).objective
    errors = [abs(one.objective - exact) for one in found]
    worst = [one.meshes[-1].worst for one in found]
    assert np.log2(worst[0] / worst[1]) == pytest.approx(power, abs=0.3)
    for error, one in zip(errors, found, strict=True):
        assert error < 10 * np.sum(one.meshes[-1].errors)


def test_errors_are_told_of_each_realisation_and_the_worst_system_by_its_numbers():
    problem = al.Problem(
        Cart(damping=al.Uniform(0.5, half_width=0.4)),
        grid=al.Grid(3.0, 8),
        inputs={"force": al.BSpline(al.Decision(np.zeros(4), -1.0, 1.0))},
        minimize=al.integral("force").mean,
        expansion=al.Expansion(order=1),
    )
    solution = al.solve(problem, transcription=al.Simultaneous(), throw=False)
    mesh, germs = solution.mesh, solution.states.germs
    assert mesh is solution.meshes[-1]
    assert mesh.drifts.shape == (len(germs), 8)
    np.testing.assert_array_equal(mesh.errors, mesh.drifts.max(axis=0))
    worst = germs[np.argmax(mesh.drifts.max(axis=1))]
    assert mesh.numbers == pytest.approx({"damping": 0.5 + 0.4 * worst[0]})
    assert f"with damping = {mesh.numbers['damping']:.6g}" in str(mesh)


def test_only_intervals_that_err_are_divided():
    mesh = Mesh((0.0, 0.5, 1.0), al.schemes.HermiteSimpson())
    parts = parts_of(np.array([1e-7, 1e-4]), 1e-6, 3)
    assert parts[0] == 1 < parts[1]
    finer = mesh.refined(al.schemes.Radau(4), parts)
    assert finer.scheme == al.schemes.Radau(4)
    assert finer.nodes[:2] == (0.0, 0.5)
    assert len(finer.nodes) == 2 + parts[1]
    np.testing.assert_allclose(finer.lengths[1:], 0.5 / parts[1])


@pytest.mark.parametrize("error", [0.0, -1e-6, 1.0, 1e-13, float("nan"), "1e-6", True])
def test_an_error_is_a_small_positive_number(error):
    with pytest.raises(al.ProblemError, match="Simultaneous: error"):
        al.Simultaneous(error=error)


def test_a_mesh_that_does_not_converge_is_told_with_its_place(monkeypatch):
    monkeypatch.setattr("aleator.transcription.simultaneous._transcribed._MOST_MESHES", 2)
    with pytest.warns(al.GridWarning, match=r"mesh does not reach .* from t = .* where 1e-09 is asked"):
        solution = al.solve(swing(), transcription=al.Simultaneous(error=1e-9))
    assert len(solution.meshes) == 2
    assert not solution.meshes[-1].is_met
