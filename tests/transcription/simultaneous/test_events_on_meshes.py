"""Collocated motions that end by an event in each realisation, and events that need phases, against closed forms."""

import textwrap

import numpy as np
import pytest

import aleator as al
from aleator.transcription.simultaneous._mesh import Mesh, joined
from bouncing import Ball
from zoo import G, Shot, optimum


class Blown(Shot):
    """What is thrown, in the wind."""

    def rhs(self, t, z, wind):
        return z.vx, z.vy, wind, -G

    def outputs(self, t, z, wind):
        return {"x": z.x, "y": z.y, "wind": wind}


LANDING = al.Grid(until="ground", at_most=6.0, steps=8)
CALM = al.BSpline(np.zeros(4), degree=3)


def thrown(wind=CALM, angle=0.6, **options):
    shot = Blown(al.Uniform(20.0, half_width=2.0), al.Decision(angle, 0.2, 1.2))
    return al.Problem(shot, inputs={"wind": wind}, **({"grid": LANDING, "minimize": -al.terminal("x").mean} | options))


@pytest.mark.slow
def test_the_range_has_the_mean_and_the_spread_of_its_closed_form():
    times, ranges = al.at("ground"), al.at("ground", "x")
    limits = [times.mean <= 10.0, times.std <= 10.0, ranges.std <= 100.0, al.integral("y").mean <= 100.0]
    found = optimum(thrown(subject_to=limits), transcription=al.Simultaneous())
    statistics = found.transcribed.statistics(found.outcome.point)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    speeds, weights = 20.0 + 2.0 * nodes, weights / 2
    lasts = 2 * speeds * np.sin(np.pi / 4) / G
    assert found.decisions["angle"] == pytest.approx(np.pi / 4, abs=1e-7)
    for kind, values in {"x(t_ground)": speeds**2 / G, "t_ground": lasts}.items():
        spread = np.sqrt(weights @ (values - weights @ values) ** 2)
        assert statistics[f"σ[{kind}]"] == pytest.approx(spread, rel=1e-8)
    assert statistics["μ[x(t_f)]"] == pytest.approx(weights @ speeds**2 / G, rel=1e-8)
    # The area under a parabola is two thirds of what is around it.
    area = weights @ (lasts * (speeds * np.sin(np.pi / 4)) ** 2 / (3 * G))
    assert statistics["μ[∫y dt]"] == pytest.approx(area, rel=1e-8)


def test_what_has_no_place_on_a_mesh_is_refused():
    for words, problem in {
        r"no place for the event 'top' inside a grid. End a phase there": thrown(subject_to=[al.at("top").mean <= 3.0]),
        r"while each realisation ends at its own 'ground'.* Give an al.BSpline": thrown(al.Control(0.0)),
    }.items():
        with pytest.raises(al.ProblemError, match=words):
            al.solve(problem, transcription=al.Simultaneous())


def test_phases_that_share_a_control_have_the_same_nodes():
    shot, wind = Blown(20.0, al.Decision(0.6, 0.2, 1.2)), al.Control(0.0, degree=1)
    grids = {"rise": al.Grid(1.0, 2), "fall": al.Grid(1.0, 3), "rest": al.Grid(1.0, 4)}
    phases = {name: al.Phase(shot, grid, {"wind": wind if name != "rest" else CALM}) for name, grid in grids.items()}
    problem = al.Problem(al.Phases(**phases), minimize=al.terminal("x").mean)
    meshes = joined(problem, [Mesh(tuple(one.fractions.tolist()), al.schemes.Radau(2)) for one in grids.values()])
    first, second, third = (one.nodes for one in meshes)
    assert first == second == pytest.approx([0.0, 1 / 3, 0.5, 2 / 3, 1.0])
    assert len(third) == 5


# --- Events inside a grid, which collocation has as phases ------------------------------------------------------------


NUMBERS = al.Uniform(0.7, half_width=0.1), al.Decision(0.95, 0.9, 1.0)
LOWEST = {
    "minimize": al.terminal("h").mean,
    "subject_to": [al.terminal("h").std <= 1.0],
    "expansion": al.Expansion(order=4),
}


def refusal(**parts):
    with pytest.raises(al.ProblemError, match="no place for the event 'floor' inside a grid") as caught:
        al.solve(al.Problem(**LOWEST | parts), transcription=al.Simultaneous())
    return str(caught.value)


@pytest.mark.slow
def test_a_grid_with_bounces_is_refused_with_phases_that_have_the_mean_and_spread_of_the_closed_form():
    said, _, code = refusal(system=Ball(*NUMBERS), grid=al.Grid(1.2, 12)).partition(":\n\n")
    assert said.endswith("each realisation meets 'floor', 'floor'")
    written = {"al": al, "Ball": Ball, "NUMBERS": NUMBERS}
    exec(textwrap.dedent(code).replace("(...)", "(*NUMBERS)"), written)
    solution = al.solve(al.Problem(written["flight"], **LOWEST), transcription=al.Simultaneous())
    # The lower the start, the higher the ball is on its third flight: it starts from 1 m.
    assert solution.decisions["part_1.height"] == pytest.approx(1.0, abs=1e-6)
    assert solution.statistics["μ[part_3.h(t_f)]"] == pytest.approx(0.1558396995, abs=1e-7)
    assert solution.statistics["σ[part_3.h(t_f)]"] == pytest.approx(0.0302186563, abs=1e-7)
    assert solution.ok
