"""Events inside a grid, which collocation has as phases: what it says to write is right as it stands."""

import textwrap

import pytest

import aleator as al
from bouncing import Ball

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


def test_realisations_that_bounce_more_often_than_others_are_told_with_their_share():
    # The second bounce, of a fall from 0.95 m, is at (1 + 2 e) sqrt(1.9 / g): before 1.1 s where e < 0.75.
    said = refusal(system=Ball(*NUMBERS), grid=al.Grid(1.1, 12))
    assert "% of them meet 'floor', 'floor'; " in said
    assert "% of them meet 'floor': bound the distributions" in said
