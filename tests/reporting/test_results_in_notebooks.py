"""What a notebook shows of a result: a small table, escaped, that says what is printed."""

import re
from html.parser import HTMLParser

import numpy as np
import pytest
import report_problems as given
import shown_results as shown

import aleator as al
from aleator.reporting.drawn import facts_of

MORE = {
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
EVERY = shown.EVERY | MORE


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


@pytest.mark.parametrize("name", EVERY)
def test_every_result_is_shown_as_well_formed_markup_that_holds_what_is_printed(name):
    result = EVERY[name]()
    page = result._repr_html_()
    assert str(result).strip() in Checked(page).text
    assert facts_of(result).heading
    assert "<script" not in page
    assert "background" not in page  # readable on light and on dark
    assert not re.search(r"[^-]color:", page)


@pytest.mark.parametrize(
    "name", ["solution", "evidence", "front", "calibration", "trade-off of two", "refused", "problem"]
)
def test_names_with_markup_are_escaped(name):
    page = EVERY[name]()._repr_html_()
    assert "&lt;b&gt;" in page
    inside = page.split("</p>", 1)[1]
    assert "<b>" not in inside


def test_a_solution_shows_its_decisions_objective_and_limits_with_units():
    solution = given.solution()
    text = Checked(solution._repr_html_()).text.replace("\u202f", " ")
    assert text.startswith("Solution: solved")
    assert f"{solution.objective:.3f} m²/s³ = μ[∫effort dt]" in text
    assert f"{float(solution.decisions['c.mean']):.4f} N s/m" in text
    assert "limit reach <b>&" in text


def test_evidence_shows_shares_with_intervals_and_both_means():
    evidence = given.evidence()
    text = Checked(evidence._repr_html_()).text.replace("\u202f", " ")
    assert "400 fresh systems" in text
    assert f"{100 * evidence.joint.estimate:.1f} % [" in text
    assert f"{float(evidence.functionals['∫effort dt'].expanded_mean):.3f}" in text


def test_a_long_front_is_cut_and_says_how_much_is_left_out():
    front = given.front()
    long = al.results.Front(front.bound, np.arange(20.0), (given.solution(),) * 20)
    page = long._repr_html_()
    assert page.count("<tr>") == 13
    assert "and 8 more." in page


def test_a_model_shows_its_numbers_with_distributions_and_units():
    text = Checked(given.problem(0.2).system._repr_html_()).text
    assert "A mass released from rest on a damped spring." in text
    assert "Uniform(mean=4" in text
    assert "N/m" in text
