"""Design problems solved by searches without derivatives: the same language, the same certificates."""

import signal
from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
import xarray

import aleator as al
from aleator.extending import save
from aleator.nlp import FilterSQP
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
    cases([POPULATION, al.solvers.Direct(), al.solvers.DualAnnealing(), al.solvers.CmaEs()]),
    ids=lambda one: type(one).__name__,
)
def test_the_global_optimum_of_a_design_is_reached(solver):
    design = searched() if solver is POPULATION else al.solve(declared(), replace(solver, evaluations=600))
    assert design.objective == pytest.approx(least(), rel=1e-5)
    assert al.solve(declared()).objective > least() + 0.1
    assert design.effort.evaluations > design.effort.searched.evaluations


@pytest.mark.slow
def test_limits_hold_at_the_answer_of_a_search_and_of_each_point_of_a_front():
    front = al.pareto(declared(), "low", [-0.6, -0.5], solver=POPULATION)
    assert [design.ok for design in front.points] == [True, True]
    assert [design.constraints[0].worst for design in front.points] == pytest.approx([-0.6, -0.5], abs=1e-6)
    worst = al.solve(declared(limits=[X.at_least(-0.5, worst_case=True)]), POPULATION)
    assert worst.ok
    assert worst.certificate.worst_case is not None
    assert worst.effort.searched.evaluations <= POPULATION.evaluations


def test_many_designs_in_one_call_have_the_values_of_one_after_the_other():
    program = transcribe(declared()).program
    assert program.values is not None
    points = np.stack([np.linspace(0.1, 5.9, 531), np.linspace(0.0, 1.0, 531)], axis=1)
    objectives, rows = program.values(points)
    for which in (0, 300, 530):
        alone = program.evaluate(points[which])
        assert objectives[which] == pytest.approx(alone.objective, rel=1e-12)
        np.testing.assert_allclose(rows[which], alone.constraints, rtol=1e-10, atol=1e-12)


@pytest.mark.usefixtures("python_interrupts")
def test_ctrl_c_ends_the_search_and_keeps_the_best_design():
    def stop(task, done, total):
        if done > 100:
            signal.raise_signal(signal.SIGINT)

    design = al.solve(declared(), al.solvers.DifferentialEvolution(evaluations=100_000, population=24, progress=stop))
    assert design.ok
    assert design.effort.searched.end == "stopped by the user"
    assert design.effort.searched.evaluations < 200


def test_the_history_of_a_search_is_kept_and_drawn(tmp_path):
    design = searched()
    history = design.effort.searched
    best = history.best()
    assert (np.diff(best[~np.isnan(best)]) <= 0).all()
    assert best[-1] == pytest.approx(np.nanmin(history.objectives))
    drawn = al.reporting.search_figure(history).data
    assert any(len(one.y) == history.evaluations for one in drawn)
    assert "by differential evolution" in al.report(design, path=tmp_path / "page.html").read_text()
    save(tmp_path, design=design)
    with xarray.open_dataset(tmp_path / "results.nc", group="design", engine="h5netcdf") as stored:
        np.testing.assert_array_equal(stored["searched objective"], history.objectives)


def test_what_a_search_cannot_do_is_refused_by_name():
    with pytest.raises(al.ProblemError, match=r"finite bounds of every decision; 'phase' has none.*NelderMead"):
        al.solve(declared(phase=(3.0, 0.0)), POPULATION)
    with pytest.raises(al.ProblemError, match=r"DifferentialEvolution without polishing cannot hold an equality"):
        al.solve(declared(limits=[X.mean.equals(0.2)]), al.solvers.DifferentialEvolution(polish=False))


@pytest.mark.slow
def test_values_choose_where_derivatives_cannot():
    wish = (al.output("rounded").mean - 2.0) ** 2 + (al.output("other").mean - 1.0) ** 2
    problem = declared(phase=(1.4, -4.0, 4.0), minimize=wish, limits=[])
    with pytest.raises(al.ProblemError, match=r"no solver by derivatives can choose.*let a search compare values"):
        al.solve(problem)
    # Where this search ends on the stretch of `phase` that rounds to 2 is by rounding: near the jumps or far from them.
    design = al.solve(problem, al.solvers.DualAnnealing(evaluations=300, seed=0))
    assert design.objective == pytest.approx(0.0, abs=1e-9)
    assert round(design.decisions["phase"]) == 2
    assert "its values alone chose 'phase', by which its derivatives are zero" in str(design)


@pytest.mark.usefixtures("python_interrupts")
def test_ctrl_c_while_a_design_is_polished_keeps_it_with_its_status(monkeypatch):
    original = FilterSQP.minimise

    def interrupted(self, scaled, multipliers):
        signal.raise_signal(signal.SIGINT)
        return original(self, scaled, multipliers)

    monkeypatch.setattr(FilterSQP, "minimise", interrupted)
    with pytest.raises(al.SolveError, match="interrupted by the user") as caught:
        al.solve(declared(), POPULATION)
    design = caught.value.solution
    assert design.status is al.Status.INTERRUPTED
    assert design.objective < least() + 0.1
    assert "polishing was stopped by the user" in str(design)
