"""Figures for papers: Plotly writes them as vector graphics, with the numbers, the units and the names of the page."""

import html
import re
import tempfile
from pathlib import Path

import numpy as np
import plotly.io
import pytest
import report_problems as given
import shown_results as shown

pytest.importorskip("kaleido", reason="kaleido is not installed")


COLUMN = {"width": 420, "height": 320}
"""The size of a column: 3.5 inches of 120 pixels."""


def pictures(*figures):
    """Some figures as SVG, each with the texts in it, written by one browser."""
    try:
        with tempfile.TemporaryDirectory() as folder:
            paths = [Path(folder) / f"{i}.svg" for i in range(len(figures))]
            plotly.io.write_images(list(figures), paths, **COLUMN)
            written = [path.read_text(encoding="utf-8") for path in paths]
    except RuntimeError as error:
        if "Chrome" not in str(error):
            raise
        pytest.skip("kaleido finds no Chromium")
    for picture in written:
        assert re.search(r'<svg[^>]* width="420" height="320"', picture)
    texts = [re.findall(r"<text[^>]*>(.*?)</text>", picture, flags=re.DOTALL) for picture in written]
    return written, [{html.unescape(re.sub("<[^>]*>", " ", one)).strip() for one in each} for each in texts]


def test_usual_figures_are_saved_for_a_paper():
    names = ["evidence", "trade-off of three", "portfolio", "penalties", "mesh"]
    written, _ = pictures(*(shown.EVERY[name]().plot() for name in names))
    assert len(written) == len(names)


def test_a_band_on_paper_has_the_numbers_and_units_of_the_solution():
    solution = given.solution()
    (picture,), (texts,) = pictures(solution.plot.band("back", sigmas=2.0))
    assert {"Time (s)", "back (m)", "mean of back ± 2 σ", "reach <b>&: 0.2\u202fm at 1 σ"} <= texts
    moments = solution.moments["back(t)"]
    # Pixels count downwards, and those of the least and the largest mean give the scale.
    paths = re.findall(r'<path class="js-(?:line|fill)" d="([^"]*)"', picture)
    heights = [np.array(re.findall(r"[ML]-?[\d.]+,(-?[\d.]+)", path), float) for path in paths]
    # The entry of the legend is a dash.
    band, *_, line = (one for one in heights if len(one) > 2)
    scale = np.ptp(moments.mean) / np.ptp(line)
    values = moments.mean.max() - scale * (np.array([line[0], line[-1], band.min()]) - line.min())
    expected = [moments.mean[0], moments.mean[-1], (moments.mean + 2 * moments.std).max()]
    np.testing.assert_allclose(values, expected, atol=0.01)


def test_bars_and_intervals_on_paper_have_their_heights():
    share = given.evidence().violations[given.NAME]
    figures = shown.expanded().plot.sensitivities("sum <b>&"), given.evidence().plot.violations()
    (bars, shares), (texts, _) = pictures(*figures)
    assert {"u", "r", "alone (Sobol index)"} <= texts
    ends = re.findall(r'<g class="point"><path d="M[^V]*V(-?[\d.]+)H[^V]*V(-?[\d.]+)Z"', bars)
    heights = [abs(float(top) - float(foot)) for top, foot in ends]
    np.testing.assert_allclose(np.array(heights) / heights[0], [1.0, 4 / 9] * 2, rtol=0.01)
    top, foot = map(float, re.search(r'class="yerror" d="M[\d.]+,([\d.]+)h8m-4,0V([\d.]+)', shares).groups())
    middle = float(re.search(r'class="point" transform="translate\([\d.]+,([\d.]+)\)', shares)[1])
    ratio = (share.upper - share.estimate) / (share.estimate - share.lower)
    assert (middle - top) / (foot - middle) == pytest.approx(ratio, rel=0.01)
