"""What a notebook shows of a result: a small table, escaped, that says what is printed."""

import re
from html.parser import HTMLParser

import numpy as np
import pytest
import report_problems as given
import shown_results as shown

import aleator as al
from aleator.reporting.drawn import facts_of

EVERY = shown.EVERY | {
    "problem": lambda: given.problem(0.2),
    "model": lambda: given.problem(0.2).system,
    "certificate": lambda: given.solution().certificate,
    "constraint": lambda: given.solution().constraints[0],
    "moments": lambda: given.solution().moments["back(t)"],
    "sampled": lambda: given.evidence().functionals["∫effort dt"],
    "share": lambda: given.evidence().joint,
    "refused": lambda: al.results.Refused(given.problem(0.2), "no <b>design & why"),
    "limit": lambda: al.results.Limit("x <b>", ("x ≤ 1 & y",), (0.5,), 2.0),
}
MARKED = ("solution", "evidence", "front", "calibration", "trade-off of two", "refused", "problem")


class Checked(HTMLParser):
    """Every tag that is opened is closed, and no other tags are there than those of tables and texts."""

    KNOWN = frozenset({"div", "p", "b", "table", "caption", "tr", "th", "td", "pre", "details", "summary"})

    def __init__(self, page):
        super().__init__()
        self.open, self.text = [], ""
        self.feed(page)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        assert tag in self.KNOWN, tag
        self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def shown_text(result):
    return Checked(result._repr_html_()).text.replace("\u202f", " ")


@pytest.mark.parametrize("name", EVERY)
def test_every_result_is_shown_as_well_formed_markup_that_holds_what_is_printed(name):
    result = EVERY[name]()
    page = result._repr_html_()
    assert str(result).strip() in Checked(page).text
    assert facts_of(result).heading
    assert "<script" not in page
    assert "background" not in page  # readable on light and on dark
    assert not re.search(r"[^-]color:", page)
    if name in MARKED:
        assert "&lt;b&gt;" in page
        assert "<b>" not in page.split("</p>", 1)[1]


def test_results_show_their_numbers_with_units():
    solution, evidence = given.solution(), given.evidence()
    text = shown_text(solution)
    assert text.startswith("Solution: solved")
    assert f"{solution.objective:.3f} m²/s³ = μ[∫effort dt]" in text
    assert f"{float(solution.decisions['c.mean']):.4f} N s/m" in text
    assert "limit reach <b>&" in text
    text = shown_text(evidence)
    assert "400 fresh systems" in text
    assert f"{100 * evidence.joint.estimate:.1f} % [" in text
    assert f"{float(evidence.functionals['∫effort dt'].expanded_mean):.3f}" in text
    text = shown_text(given.problem(0.2).system)
    for said in ("A mass released from rest on a damped spring.", "Uniform(mean=4", "N/m"):
        assert said in text


def test_a_long_front_is_cut_and_says_how_much_is_left_out():
    long = al.results.Front(given.NAME, np.arange(20.0), (given.solution(),) * 20)
    page = long._repr_html_()
    assert page.count("<tr>") == 13
    assert "and 8 more." in page
