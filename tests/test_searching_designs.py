"""Design problems solved by searches without derivatives: the same language, the same certificates."""

import json
import signal
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
import xarray

import aleator as al
from aleator.extending import save

POPULATION = al.solvers.DifferentialEvolution(evaluations=600, population=24)


class Resonator(al.System):
    """A decay towards a level that is a wave in one decision: many minima."""

    states = ("x",)

    rate: al.Number
    phase: al.Number

    def rhs(self, t, z):
        return (-self.rate * (z.x - jnp.sin(3.0 * self.phase) - 0.1 * self.phase),)

    def outputs(self, t, z):
        return {"x": z.x}


def declared(**more):
    phase = more.pop("phase", al.Decision(3.0, 0.0, 6.0))
    return al.Problem(
        Resonator(al.Uniform(2.0, half_width=0.2), phase),
        grid=al.Grid(2.0, 20),
        minimize=more.pop("minimize", al.terminal("x").mean),
        expansion=al.Expansion(order=2),
        **more,
    )


def least():
    """The least terminal mean over a fine raster, by the closed form of the decay."""
    phase, rates = np.linspace(0.0, 6.0, 60001), np.linspace(1.8, 2.2, 2001)
    rise = np.trapezoid(1.0 - np.exp(-2.0 * rates), rates) / 0.4
    return float(np.min(rise * (np.sin(3.0 * phase) + 0.1 * phase)))


@pytest.mark.parametrize(
    "solver",
    [POPULATION, al.solvers.Direct(evaluations=300), al.solvers.DualAnnealing(evaluations=600), al.solvers.CmaEs()],
    ids=lambda one: type(one).__name__,
)
def test_the_global_optimum_of_a_design_is_found(solver):
    found = al.solve(declared(), replace(solver, evaluations=600))
    assert found.objective == pytest.approx(least(), rel=1e-5)
    assert al.solve(declared()).objective > least() + 0.1
    assert found.effort.searched is not None
    assert found.effort.evaluations > found.effort.searched.evaluations
    assert "evaluations" in str(found.effort)


def test_many_designs_in_one_call_have_the_values_of_one_after_the_other():
    from aleator.transcription import transcribe

    held = al.path("x").within(-5.0, 5.0, sigmas=2.0)
    program = transcribe(declared(subject_to=[held])).program
    assert program.values is not None
    points = np.linspace(0.1, 5.9, 531)[:, None]
    objectives, rows = program.values(points)
    for which in (0, 1, 300, 530):
        alone = program.evaluate(points[which])
        assert objectives[which] == pytest.approx(alone.objective, rel=1e-12)
        np.testing.assert_allclose(rows[which], alone.constraints, rtol=1e-10, atol=1e-12)
        first, _ = program.values(points[which : which + 1])
        assert first[0] == pytest.approx(alone.objective, rel=1e-12)


def test_the_number_of_threads_does_not_change_a_search():
    found = []
    for count in (1, 2):
        al.threads(count)
        found.append(al.solve(declared(), POPULATION))
    al.threads(None)
    np.testing.assert_array_equal(found[0].effort.searched.objectives, found[1].effort.searched.objectives)
    assert found[0].objective == found[1].objective


def test_limits_hold_at_the_answer_of_a_search():
    limit = al.terminal("x").at_least(-0.5, sigmas=1.0)
    found = al.solve(declared(subject_to=[limit]), POPULATION)
    assert found.ok
    assert found.constraints[0].worst == pytest.approx(-0.5, abs=1e-6)


def test_limits_on_the_worst_case_are_searched_for_once():
    limit = al.terminal("x").at_least(-0.5, worst_case=True)
    found = al.solve(declared(subject_to=[limit]), POPULATION)
    assert found.ok
    assert found.certificate.worst_case is not None
    assert found.effort.searched.evaluations <= POPULATION.evaluations


@pytest.mark.usefixtures("python_interrupts")
def test_ctrl_c_ends_the_search_and_keeps_the_best_design():
    def stop(task, done, total):
        if done > 100:
            signal.raise_signal(signal.SIGINT)

    solver = al.solvers.DifferentialEvolution(evaluations=100_000, population=24, progress=stop)
    found = al.solve(declared(), solver)
    assert found.ok
    assert found.effort.searched.end == "stopped by the user"
    assert found.effort.searched.evaluations < 200


def test_multistart_and_fronts_take_a_search():
    starts = al.multistart(declared(), 2, solver=POPULATION)
    assert [one.ok for one in starts.solutions] == [True, True]
    assert starts.best.objective == pytest.approx(least(), rel=1e-5)
    limit = al.terminal("x").at_least(-0.5, sigmas=1.0).named("low")
    front = al.pareto(declared(subject_to=[limit]), "low", [-0.6, -0.5], solver=POPULATION)
    assert front.solved.all()


def test_the_history_of_a_search_is_kept_and_drawn(tmp_path):
    found = al.solve(declared(), POPULATION)
    searched = found.effort.searched
    best = searched.best()
    assert (np.diff(best[~np.isnan(best)]) <= 0).all()
    assert best[-1] == pytest.approx(np.nanmin(searched.objectives))
    figure = al.reporting.search_figure(searched)
    drawn = [np.asarray(one.y, dtype=float) for one in figure.data]
    assert any(len(one) == searched.evaluations for one in drawn)
    page = al.report(found, path=tmp_path / "page.html")
    assert "by differential evolution" in page.read_text()
    save(tmp_path, design=found)
    document = json.loads((tmp_path / "designs.json").read_text())
    assert f"{searched.evaluations} evaluations" in document["design"]["certificate"]["search"]
    with xarray.open_dataset(tmp_path / "results.nc", group="design", engine="h5netcdf") as kept:
        np.testing.assert_array_equal(kept["searched objective"], searched.objectives)


@pytest.mark.parametrize(
    ("problem", "solver", "words"),
    [
        (
            lambda: declared(phase=al.Decision(3.0, 0.0)),
            POPULATION,
            r"finite bounds of every decision; 'phase' has none on at least one side. al.solvers.NelderMead",
        ),
        (
            lambda: declared(subject_to=[al.terminal("x").mean.equals(0.2)]),
            al.solvers.DifferentialEvolution(polish=False),
            r"DifferentialEvolution without polishing cannot hold an equality.*μ\[x\(t_f\)\]",
        ),
    ],
)
def test_what_a_search_cannot_do_is_refused_by_name(problem, solver, words):
    with pytest.raises(al.ProblemError, match=words):
        al.solve(problem(), solver)


def test_equations_of_motion_are_no_constraints_for_a_search():
    with pytest.raises(al.ProblemError, match=r"cannot hold equations of motion.*al\.Sequential\(\)"):
        al.solve(declared(), POPULATION, transcription=al.Simultaneous())


class Rounded(al.AlgebraicSystem):
    a: al.Number
    b: al.Number
    off: al.Number

    def outputs(self):
        return {"r": jnp.round(self.a) + self.off, "b": self.b + self.off}


def rounded():
    decisions = al.Decision(1.5, -4.0, 4.0), al.Decision(0.5, -4.0, 4.0)
    wish = (al.output("r").mean - 2.0) ** 2 + (al.output("b").mean - 1.0) ** 2
    return al.Problem(Rounded(*decisions, al.Uniform(0.0, half_width=0.1)), minimize=wish)


def test_values_choose_where_derivatives_cannot():
    with pytest.raises(al.ProblemError, match=r"no solver by derivatives can choose.*let a search compare values"):
        al.solve(rounded())
    # Where this search ends on the stretch of `a` that rounds to 2 is by rounding: near the jumps or far from them.
    for seed in range(3):
        found = al.solve(rounded(), al.solvers.DualAnnealing(evaluations=300, seed=seed))
        assert found.objective == pytest.approx(0.0, abs=1e-9)
        assert round(found.decisions["a"]) == 2
        assert "its values alone chose 'a', by which its derivatives are zero" in str(found)
    several = al.portfolio(rounded(), 4, search=al.solvers.DifferentialEvolution(evaluations=300, population=24))
    assert several.best.ok
    assert several.best.objective == pytest.approx(0.0, abs=1e-9)


@pytest.mark.usefixtures("python_interrupts")
def test_ctrl_c_while_a_design_is_polished_keeps_it_with_its_status(monkeypatch):
    from aleator.nlp import FilterSQP

    original = FilterSQP.minimise

    def interrupted(self, scaled, multipliers):
        signal.raise_signal(signal.SIGINT)
        return original(self, scaled, multipliers)

    monkeypatch.setattr(FilterSQP, "minimise", interrupted)
    found = al.solve(declared(), POPULATION, throw=False)
    assert found.status is al.Status.INTERRUPTED
    assert found.objective < least() + 0.1
    assert "polishing was stopped by the user" in str(found)
    with pytest.raises(al.SolveError, match="interrupted by the user") as caught:
        al.solve(declared(), POPULATION)
    assert caught.value.solution.objective == found.objective
    starts = al.multistart(declared(), 3, solver=POPULATION)
    assert starts.interrupted
    assert [one.status for one in starts.solutions] == [al.Status.INTERRUPTED]
    limit = al.terminal("x").at_least(-0.5, sigmas=1.0).named("low")
    front = al.pareto(declared(subject_to=[limit]), "low", [-0.6, -0.5], solver=POPULATION)
    assert front.interrupted
    assert front.values.tolist() == [-0.6]
