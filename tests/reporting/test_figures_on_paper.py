"""The same figures by Matplotlib, for papers: the numbers, the units and the names are those of Plotly's."""

import numpy as np
import pytest
import report_problems as given
import shown_results as shown

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


def test_bars_and_intervals_on_paper_have_their_heights():
    (axes,) = shown.expanded().plot.sensitivities("sum <b>&", backend="matplotlib").axes
    np.testing.assert_allclose([bar.get_height() for bar in axes.patches], [900 / 13, 400 / 13] * 2)
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["u", "r"]
    share = given.evidence().violations[given.NAME]
    (axes,) = given.evidence().plot.violations(backend="matplotlib").axes
    ends = axes.collections[-1].get_segments()[0][:, 1]
    np.testing.assert_allclose(ends, [100 * share.lower, 100 * share.upper])
