"""The same figures by Matplotlib, for papers: the numbers, the units and the names are those of Plotly's."""

import sys

import numpy as np
import plotly.graph_objects as go
import pytest
import report_problems as given
import shown_results as shown

import aleator as al
from aleator.reporting import Look, Scene, mesh_figure, paper_figure, plane_figure
from aleator.reporting._style import blank

pytest.importorskip("matplotlib", reason="matplotlib is not installed")


def curves(paper):
    """The points of every line on the first axes, by its name."""
    (axes, *_) = paper.axes
    return {one.get_label(): np.column_stack(one.get_data()) for one in axes.lines}


SOME = ("evidence", "trade-off of three", "portfolio", "penalties", "mesh")


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=[pytest.mark.slow] * (one not in SOME)) for one in shown.EVERY]
)
def test_every_usual_figure_is_saved_for_a_paper(name, tmp_path):
    figure = shown.EVERY[name]().plot(backend="matplotlib")
    figure.savefig(tmp_path / "figure.svg")
    assert "<svg" in (tmp_path / "figure.svg").read_text(encoding="utf-8")[:2000]
    assert figure.get_size_inches()[0] == 3.5


def test_a_band_on_paper_has_the_numbers_and_units_of_the_solution():
    solution = given.solution()
    paper = solution.plot.band("back", sigmas=2.0, backend="matplotlib")
    (axes,) = paper.axes
    moments = solution.moments["back(t)"]
    line = curves(paper)["mean of back ± 2 σ"]
    np.testing.assert_allclose(line, np.column_stack([solution.instants, moments.mean]), rtol=1e-6)
    corners = axes.patches[0].get_xy()
    half = len(moments.mean)
    np.testing.assert_allclose(corners[:half, 1], moments.mean + 2 * moments.std, rtol=1e-5)
    assert axes.get_xlabel() == "Time (s)"
    assert axes.get_ylabel() == "back (m)"
    assert [text.get_text() for text in axes.texts] == ["reach <b>&: 0.2\u2009m at 1 σ"]
    assert [text.get_text() for text in paper.legends[0].get_texts()] == ["mean of back ± 2 σ"]


def test_a_front_on_paper_has_its_optima_with_filled_and_open_markers():
    front = given.front()
    (axes,) = front.plot(backend="matplotlib").axes
    solved = front.solved
    points = np.array([xy for one in axes.lines if one.get_marker() == "s" for xy in zip(*one.get_data(), strict=True)])
    points = points[np.isfinite(points).all(axis=1)]
    np.testing.assert_allclose(np.sort(points[:, 1]), np.sort(front.objectives[solved]))
    shades = {one.get_markerfacecolor() for one in axes.lines if one.get_marker() == "s"}
    assert "white" in shades
    assert len(shades) == 2


def test_bars_on_paper_have_the_heights_of_the_indices():
    (axes,) = shown.expanded().plot.sensitivities("sum <b>&", backend="matplotlib").axes
    heights = [bar.get_height() for bar in axes.patches]
    np.testing.assert_allclose(heights, [900 / 13, 400 / 13] * 2)
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["u", "r"]


def test_points_in_space_and_side_by_side_are_those_of_the_trade_off():
    front = shown.trade_off(3)
    (axes,) = front.plot(backend="matplotlib").axes
    np.testing.assert_allclose(np.transpose(axes.collections[0]._offsets3d), front.values)
    assert axes.get_ylabel() == "spread ‹b›& (m²/s³)"
    front = shown.trade_off(4)
    (axes,) = front.plot(backend="matplotlib").axes
    low, high = front.values.min(axis=0), front.values.max(axis=0)
    for line, row in zip(axes.lines, front.values, strict=False):
        np.testing.assert_allclose(line.get_ydata(), (row - low) / (high - low))
    assert {text.get_text() for text in axes.texts} >= {"9", "1"}


def test_violations_on_paper_keep_their_intervals():
    share = given.evidence().violations[given.NAME]
    (axes,) = given.evidence().plot.violations(backend="matplotlib").axes
    ends = axes.collections[-1].get_segments()[0][:, 1]
    np.testing.assert_allclose(ends, [100 * share.lower, 100 * share.upper])


def test_meshes_on_paper_have_two_pairs_of_axes():
    meshes = given.collocated().meshes
    paper = paper_figure(mesh_figure(meshes))
    lower, upper = paper.axes
    errors = [one.get_ydata() for one in lower.lines]
    np.testing.assert_allclose(errors[0][:-1], meshes[0].errors, rtol=1e-6)
    assert len(upper.lines) == len(meshes)


def test_a_plane_on_paper_has_equal_scales_its_obstacle_and_its_wall():
    paths = np.array([[[0.5, 0.0], [1.0, 2.0]], [[0.5, 0.0], [1.5, 2.0]]])
    scene = Scene(discs=[(1.0, 1.0, 0.25)], wall=0.0)
    (axes,) = paper_figure(plane_figure(paths, paths[0], look=Look("#0072b2", "square"), scene=scene)).axes
    assert axes.get_aspect() == 1.0
    disc, wall = (one.get_extents().transformed(axes.transData.inverted()) for one in axes.patches)
    np.testing.assert_allclose([disc.x0, disc.y0, disc.x1, disc.y1], [0.75, 0.75, 1.25, 1.25], rtol=1e-9)
    assert wall.x1 == pytest.approx(0.0, abs=1e-12)
    assert {text.get_text() for text in axes.texts} == {"obstacle", "wall"}


@pytest.mark.parametrize("odd", ["animation", "pie", "path"])
def test_what_has_no_form_on_paper_is_refused(odd):
    figure = blank("x", "y")
    figure.add_scatter(x=[0.0], y=[0.0], mode="markers", marker={"color": "#0072b2"})
    if odd == "animation":
        figure.frames = [go.Frame(data=[])]
    if odd == "pie":
        figure.add_pie(values=[1.0])
    if odd == "path":
        figure.add_shape(type="path", path="M 0,0 L 1,1")
    with pytest.raises(al.ProblemError, match=f"A figure on paper: expected .*; received .*{odd}"):
        paper_figure(figure)


def test_without_matplotlib_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(al.MissingExtraError, match=r"aleator\[paper\]"):
        given.solution().plot(backend="matplotlib")
