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


@pytest.mark.parametrize("name", ["evidence", "trade-off of three", "portfolio", "penalties", "mesh"])
def test_a_usual_figure_is_saved_for_a_paper(name, tmp_path):
    figure = shown.EVERY[name]().plot(backend="matplotlib")
    figure.savefig(tmp_path / "figure.svg")
    assert "<svg" in (tmp_path / "figure.svg").read_text(encoding="utf-8")[:2000]
    assert figure.get_size_inches()[0] == 3.5


def test_a_band_on_paper_has_the_numbers_and_units_of_the_solution():
    solution = given.solution()
    paper = solution.plot.band("back", sigmas=2.0, backend="matplotlib")
    (axes,) = paper.axes
    moments = solution.moments["back(t)"]
    (line,) = [one for one in axes.lines if one.get_label() == "mean of back ± 2 σ"]
    np.testing.assert_allclose(line.get_data(), [solution.instants, moments.mean], rtol=1e-6)
    corners = axes.patches[0].get_xy()[: len(moments.mean)]
    np.testing.assert_allclose(corners[:, 1], moments.mean + 2 * moments.std, rtol=1e-5)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("Time (s)", "back (m)")
    assert [text.get_text() for text in axes.texts] == ["reach <b>&: 0.2\u2009m at 1 σ"]
    assert [text.get_text() for text in paper.legends[0].get_texts()] == ["mean of back ± 2 σ"]


def test_a_front_on_paper_has_its_optima_with_filled_and_open_markers():
    front = given.front()
    (axes,) = front.plot(backend="matplotlib").axes
    marked = [one for one in axes.lines if one.get_marker() == "s"]
    drawn = np.concatenate([one.get_ydata() for one in marked]).astype(float)
    np.testing.assert_allclose(np.sort(drawn[np.isfinite(drawn)]), np.sort(front.objectives[front.solved]))
    shades = {one.get_markerfacecolor() for one in marked}
    assert "white" in shades
    assert len(shades) == 2


def test_bars_and_intervals_on_paper_have_their_heights():
    (axes,) = shown.expanded().plot.sensitivities("sum <b>&", backend="matplotlib").axes
    np.testing.assert_allclose([bar.get_height() for bar in axes.patches], [900 / 13, 400 / 13] * 2)
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["u", "r"]
    share = given.evidence().violations[given.NAME]
    (axes,) = given.evidence().plot.violations(backend="matplotlib").axes
    ends = axes.collections[-1].get_segments()[0][:, 1]
    np.testing.assert_allclose(ends, [100 * share.lower, 100 * share.upper])


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


def test_meshes_on_paper_have_two_pairs_of_axes():
    meshes = given.collocated().meshes
    lower, upper = paper_figure(mesh_figure(meshes)).axes
    np.testing.assert_allclose(lower.lines[0].get_ydata()[:-1], meshes[0].errors, rtol=1e-6)
    assert len(upper.lines) == len(meshes)


def test_a_plane_on_paper_has_equal_scales_its_obstacle_and_its_wall():
    paths = np.array([[[0.5, 0.0], [1.0, 2.0]], [[0.5, 0.0], [1.5, 2.0]]])
    scene = Scene(discs=[(1.0, 1.0, 0.25)], wall=0.0)
    (axes,) = paper_figure(plane_figure(paths, paths[0], look=Look("#0072b2", "square"), scene=scene)).axes
    assert axes.get_aspect() == 1.0
    disc, wall = (one.get_extents().transformed(axes.transData.inverted()) for one in axes.patches)
    np.testing.assert_allclose([disc.x0, disc.y0, disc.x1, disc.y1], [0.75, 0.75, 1.25, 1.25], rtol=1e-9)
    assert wall.x1 == pytest.approx(0.0, abs=1e-12)


def test_what_has_no_form_on_paper_is_refused_and_without_matplotlib_the_error_names_the_extra(monkeypatch):
    animated, round_one = blank("x", "y"), blank("x", "y")
    animated.frames = [go.Frame(data=[])]
    round_one.add_pie(values=[1.0])
    for figure, said in ((animated, "received .*animation"), (round_one, "received .*pie")):
        with pytest.raises(al.ProblemError, match=said):
            paper_figure(figure)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(al.MissingExtraError, match=r"aleator\[paper\]"):
        given.solution().plot(backend="matplotlib")
