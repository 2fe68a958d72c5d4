"""The figures of each result show its numbers, with their units."""

import html
import re

import numpy as np
import plotly.graph_objects
import pytest
import report_problems as given
import scipy
import shown_results as shown

import aleator as al
from aleator.reporting import mesh_figure
from aleator.reporting._paths import limits_of


def named(figure, name):
    """The trace of a figure by the beginning of its name."""
    (found,) = [
        one for one in figure.data if (one.name or "").startswith(name) and one.x is not None and len(one.x) > 1
    ]
    return found


def titles(figure):
    return figure.layout.xaxis.title.text, figure.layout.yaxis.title.text


def numbers(values):
    return np.array(values, dtype=float)


# Densities of expansions take long to compile: those of `expanded` are drawn below.
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name in ("tolerance analysis", "solution by collocation")))
        for name in shown.EVERY
        if name != "expanded function"
    ],
)
def test_every_result_has_a_usual_figure_one_line_and_a_table_for_notebooks_that_holds_what_is_printed(name):
    result = shown.EVERY[name]()
    figure = result.plot()
    assert isinstance(figure, plotly.graph_objects.Figure)
    assert len(figure.data) > 0
    (line,) = repr(result).splitlines()
    assert line.startswith(f"<{type(result).__name__}")
    assert len(line) < 300
    assert str(result).strip() in html.unescape(re.sub("<[^>]*>", "", result._repr_html_()))


def test_a_band_shows_mean_and_spread_of_a_path_and_the_limit_on_them():
    solution = given.solution()
    figure = solution.plot.band("back", sigmas=2.0)
    moments = solution.moments["back(t)"]
    mean = named(figure, "mean of back ± 2 σ")
    np.testing.assert_allclose(numbers(mean.x), solution.instants, rtol=1e-6)
    np.testing.assert_allclose(numbers(mean.y), moments.mean, rtol=1e-6)
    (band,) = [one for one in figure.data if one.fill == "toself"]
    upper, lower = np.split(numbers(band.y), 2)
    np.testing.assert_allclose(upper, moments.mean + 2 * moments.std, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(lower[::-1], moments.mean - 2 * moments.std, rtol=1e-5, atol=1e-7)
    assert titles(figure) == ("Time (s)", "back (m)")
    assert [one.y0 for one in figure.layout.shapes] == [0.2]
    assert figure.layout.annotations[0].text == "reach &lt;b&gt;&amp;: 0.2\u202fm at 1 σ"


def test_limits_on_a_path_are_drawn_with_the_systems_for_which_they_hold_and_where_they_are_active():
    back, solution = al.path("back"), given.solution()
    both = [back.at_most(0.2, worst_case=True).named("reach"), back.at_least(-1.5, sigmas=3**0.5).named("start")]
    system, objective = given.problem().system, al.integral("effort").mean
    limits = limits_of(al.Problem(system, grid=al.Grid(4.0, 50), minimize=objective, subject_to=both), back)
    assert limits.texts == {0.2: "reach: 0.2\u202fm in the worst case", -1.5: "start: −1.5\u202fm at 1.73 σ"}
    (limit,) = solution.constraints
    figure = solution.plot.limit(given.NAME)
    np.testing.assert_allclose(numbers(named(figure, "μ[back(t)]").y), limit.values, rtol=1e-6, atol=1e-7)
    (active,) = [one for one in figure.data if one.name == "active"]
    np.testing.assert_allclose(numbers(active.y), limit.values[limit.active], rtol=1e-6)
    assert titles(figure) == ("Time (s)", "reach &lt;b&gt;&amp; (m)")


def test_histories_are_those_of_random_systems_at_the_decisions():
    solution = given.solution()
    figure = solution.plot.histories("back", samples=3, seed=7)
    rows = numbers(next(one for one in figure.data if len(one.x) > 1).y).reshape(3, -1)[:, :-1]
    levels = np.random.default_rng(7).uniform(np.finfo(float).tiny, 1.0, (3, 2))
    names = solution.problem.placements.germ_names
    centre = {"k": 4.0, "c": float(solution.decisions["c.mean"])}
    width = {"k": 0.4, "c": 0.1}
    for row, level in zip(rows, levels, strict=True):
        k, c = (centre[name] + width[name] * (2 * level[names.index(name)] - 1) for name in ("k", "c"))
        frequency = np.sqrt(k - c**2 / 4)
        t = solution.instants
        x = np.exp(-c * t / 2) * (np.cos(frequency * t) + c / (2 * frequency) * np.sin(frequency * t))
        np.testing.assert_allclose(row, -x, atol=1e-5)


def test_states_costates_and_meshes_are_those_of_a_simultaneous_program():
    solution = given.collocated()
    for figure, found in (
        (solution.mesh_states.plot.state("v"), solution.mesh_states),
        (solution.costates.plot.costate("v"), solution.costates),
    ):
        drawn = numbers(figure.data[-1].y).reshape(len(found.germs), -1)[:, :-1]
        np.testing.assert_allclose(drawn, found["v"], rtol=1e-5, atol=1e-6)
    assert len(mesh_figure(solution.meshes).data) > len(solution.mesh.plot.mesh().data) > 0


def test_evidence_shows_sampled_moments_beside_expanded_ones_and_the_histories():
    evidence = given.evidence()
    figure, found = evidence.plot.band("back"), evidence.functionals["back(t)"]
    for name, mean in (
        ("sampled mean of back", found.mean),
        ("mean of back by the expansion", found.expanded_mean),
    ):
        np.testing.assert_allclose(numbers(named(figure, name).y), mean, rtol=1e-5)
    kept = numbers(named(figure, "20 systems").y)
    np.testing.assert_allclose(kept.reshape(20, -1)[:, :-1], evidence.trajectories[0].values, rtol=1e-5, atol=1e-6)


def test_a_sampled_density_encloses_one_and_has_the_moments_of_the_samples():
    evidence = given.evidence()
    figure = evidence.plot.density("effort")
    (line,) = figure.data
    x, y = numbers(line.x), numbers(line.y)
    assert np.trapezoid(y, x) == pytest.approx(1.0)
    sampled = evidence.functionals["∫effort dt"]
    assert np.trapezoid(x * y, x) == pytest.approx(sampled.mean, rel=0.01)
    np.testing.assert_allclose(np.percentile(sampled.values, (1, 5, 25, 50, 75, 95, 99)), sampled.percentiles)
    assert (x.min(), x.max()) == (sampled.values.min(), sampled.values.max())
    assert titles(figure) == ("∫effort dt (m²/s³)", "Density (1/(m²/s³))")


def test_a_front_shows_its_optima_its_prices_and_its_decisions():
    front = given.front()
    np.testing.assert_allclose(numbers(named(front.plot.curve(), "design").y), front.objectives)
    assert titles(front.plot()) == ("Limit of reach &lt;b&gt;&amp; (m)", "Objective (m²/s³)")
    np.testing.assert_allclose(numbers(front.plot.shadow_prices().data[0].y), front.shadow_prices)
    decided = front.plot.decision("c.mean")
    chosen = [float(one.decisions["c.mean"]) if one else np.nan for one in front.optima]
    np.testing.assert_allclose(numbers(decided.data[0].y), chosen)
    assert titles(decided)[1] == "c.mean (N s/m)"


def test_a_trade_off_shows_every_wish_of_every_design_or_two_chosen_by_their_names():
    front = shown.trade_off(3)
    (drawn,) = front.plot().data
    np.testing.assert_array_equal(np.transpose([drawn.x, drawn.y, drawn.z]), front.values)
    (drawn,) = shown.trade_off(4).plot().data
    np.testing.assert_array_equal(np.transpose([one["values"] for one in drawn.dimensions]), shown.trade_off(4).values)
    figure = front.plot.curve("reach", "effort")
    np.testing.assert_array_equal([figure.data[0].x, figure.data[0].y], front.values[:, [2, 0]].T)
    assert titles(figure) == ("reach (m)", "effort (m²/s³)")


@pytest.mark.slow
def test_the_density_of_an_expanded_output_is_that_of_its_distribution():
    (line,) = shown.expanded().plot.density("sum <b>&").data
    x = numbers(line.x)
    np.testing.assert_allclose(numbers(line.y), scipy.stats.norm(3.0, np.sqrt(13.0)).pdf(x), rtol=0.02, atol=1e-4)


@pytest.mark.slow
def test_tolerances_show_the_rejects_beyond_the_limits():
    figure = shown.tolerances().plot.density()
    assert sorted(one.x0 for one in figure.layout.shapes) == [1.8, 2.2]
    line = figure.data[0]
    np.testing.assert_allclose(numbers(line.y), scipy.stats.norm(2.0, 0.1).pdf(numbers(line.x)), rtol=0.02, atol=1e-3)
