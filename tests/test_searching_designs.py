"""Design problems solved by searches without derivatives: the same language, the same certificates."""

from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.transcription import transcribe
from zoo import algebraic, cases

POPULATION = al.solvers.DifferentialEvolution(evaluations=600, population=24)


@algebraic
def waves(phase, other, level):
    """A wave in one decision, with many minima, and a level that is uncertain; `rounded` jumps."""
    return {"x": level * (jnp.sin(3.0 * phase) + 0.1 * phase), "rounded": jnp.round(phase), "other": other}


X = al.output("x")


def declared(lowest=-5.0, phase=(3.0, 0.0, 6.0), minimize=None, limits=None):
    """The least wave of a mean level of one, which a limit at `lowest` may hold above it."""
    system = waves(al.Decision(*phase), al.Decision(0.5, 0.0, 1.0), al.Uniform(1.0, half_width=0.1))
    goal = X.mean + (al.output("other").mean - 0.5) ** 2 if minimize is None else minimize
    kept = [X.at_least(lowest, sigmas=1.0).named("low")] if limits is None else limits
    return al.Problem(system, minimize=goal, subject_to=kept, expansion=al.Expansion(order=2))


def least():
    """The least mean over a fine raster."""
    phase = np.linspace(0.0, 6.0, 600_001)
    return float(np.min(np.sin(3.0 * phase) + 0.1 * phase))


@cache
def searched():
    return al.solve(declared(), POPULATION)


@pytest.mark.parametrize(
    "solver",
    cases([POPULATION, al.solvers.CmaEs()]),
    ids=lambda one: type(one).__name__,
)
def test_the_global_optimum_of_a_design_is_reached(solver):
    design = searched() if solver is POPULATION else al.solve(declared(), replace(solver, evaluations=600))
    assert design.objective == pytest.approx(least(), rel=1e-5)
    assert al.solve(declared()).objective > least() + 0.1
    assert design.effort.evaluations > design.effort.searched.evaluations


def test_many_designs_in_one_call_have_the_values_of_one_after_the_other():
    program = transcribe(declared()).program
    assert program.values is not None
    points = np.stack([np.linspace(0.1, 5.9, 531), np.linspace(0.0, 1.0, 531)], axis=1)
    objectives, rows = program.values(points)
    for which in (0, 300, 530):
        alone = program.evaluate(points[which])
        assert objectives[which] == pytest.approx(alone.objective, rel=1e-12)
        np.testing.assert_allclose(rows[which], alone.constraints, rtol=1e-10, atol=1e-12)


def test_what_a_search_cannot_do_is_refused_by_name():
    with pytest.raises(al.ProblemError, match=r"finite bounds of every decision; 'phase' has none.*NelderMead"):
        al.solve(declared(phase=(3.0, 0.0)), POPULATION)
    with pytest.raises(al.ProblemError, match=r"DifferentialEvolution without polishing cannot hold an equality"):
        al.solve(declared(limits=[X.mean.equals(0.2)]), al.solvers.DifferentialEvolution(polish=False))
