import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest
import report_problems as given

import aleator as al
from aleator import ProblemError
from aleator.reporting import Card, Page, Section, Table, Text, Verdict, page_html, report
from aleator.reporting._numbers import count, number, percent, residual, seconds, values_text
from aleator.reporting._numbers import given as given_number
from aleator.reporting._verdict import verdict
from aleator.validation import Proportion
from zoo import LOSS, ONE_STEP, RESPONSE, gain_problem


class Reader(HTMLParser):
    """Addresses, scripts and visible text of a page."""

    def __init__(self, text):
        super().__init__()
        self.addresses, self.libraries, self.text, self._inside = [], 0, "", ""
        self.tags = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.tags.append(tag)
        self.addresses += [found[key] for key in ("src", "href", "srcset", "action") if found.get(key)]
        self.libraries += found.get("data-library") == "plotly"
        self._inside = tag

    def handle_data(self, data):
        if self._inside not in ("script", "style"):
            self.text += data


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    fronts = {"uOpt <i>": given.front()}
    return report(
        {"uOpt <i>": given.solution()}, {"uOpt <i>": given.evidence()}, fronts, path=path, title="A <script> & title"
    ).read_text(encoding="utf-8")


def test_the_page_is_one_file_that_names_no_other(page):
    reader = Reader(page)
    assert all(address.startswith(("#", "data:")) for address in reader.addresses)
    assert not re.search(r"@import|url\(\s*['\"]?http", page.split("<body>")[0])
    assert len(page) < 8e6


def test_plotly_is_embedded_exactly_once(page):
    assert Reader(page).libraries == 1
    assert page.count("plotly.js v") == 1


def test_names_are_escaped_everywhere(page):
    assert "<title>A &lt;script&gt; &amp; title</title>" in page
    outside = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert "uOpt <i>" not in outside
    assert "reach <b>&" not in outside
    assert "reach &lt;b&gt;&amp;" in outside
    assert "i" not in Reader(page).tags
    assert "b" not in Reader(page).tags


def test_the_page_carries_the_problem_the_certificate_and_how_to_read_it(page):
    text = Reader(page).text
    assert str(given.solution().problem) in text
    for words in ("Stationarity", "Leave-one-out error", "How to read this", "Monte Carlo and the expansion compared"):
        assert words in text


def test_one_solution_is_enough_and_what_is_missing_is_left_out(tmp_path):
    path = report(given.solution(), path=tmp_path / "new" / "report.html")
    text = path.read_text(encoding="utf-8")
    assert "Solved, not checked" in text
    assert 'data-library="plotly"' not in text
    assert "Trajectories" not in Reader(text).text


def test_an_infeasible_solution_is_named_first_with_the_reason(tmp_path):
    one = given.infeasible()
    text = Reader(report(one, path=tmp_path / "report.html").read_text(encoding="utf-8")).text
    assert "is not solved" in text
    assert one.why() in text
    assert text.index("Not solved") < text.index(one.why()) < text.index("Designs")


def test_repeated_headings_get_anchors_of_their_own():
    sections = [Section("Same", [Text(["one"])]), Section("Same", [Table("t", ["a"], [["1"]])])]
    text = page_html(Page("t", "s", Verdict("good", "Good", "All well", (), [Card("a", "1")]), sections))
    assert 'id="same"' in text
    assert 'id="same-2"' in text


@pytest.mark.parametrize("level", ["good", "caution", "bad"])
def test_the_verdict_is_a_mark_and_a_word_and_never_colour_alone(level):
    text = page_html(Page("t", "s", Verdict(level, "A word", "A headline"), []))
    assert "<span>A word</span>" in text
    assert f"verdict-{level}" in text
    assert text.count("<svg") == 1


def test_where_no_limit_is_counted_the_verdict_says_so_and_why_and_claims_no_share():
    problem = al.Problem(
        gain_problem().system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=[(RESPONSE.std <= 0.3).named("spread")]
    )
    solution = al.solve(problem)
    said = verdict({"design": solution}, {"design": al.validate(solution, 100)})
    assert "none was counted" in said.headline
    assert "of systems break" not in said.headline
    assert any("σ[response(t_f)] ≤ 0.3: a statistic of all systems together" in one for one in said.sentences)
    assert not any("violate" in card.label for card in said.cards)


def test_evidence_on_another_design_is_refused(tmp_path):
    other = given.front().solutions[0]
    strange = replace(given.evidence(), solution=other)
    with pytest.raises(ProblemError, match="evidence on 'design' was sampled from another design"):
        report(given.solution(), strange, path=tmp_path / "page.html")
    with pytest.raises(ProblemError, match="evidence on 'b', but no design of that name"):
        report({"a": other}, {"b": strange}, path=tmp_path / "page.html")
    assert not list(tmp_path.iterdir())


def test_the_verdict_is_on_the_proposed_design_and_tells_the_others_for_comparison():
    good, broken = given.evidence(), given.evidence()
    few = replace(good, violations={name: Proportion(1, 1000) for name in good.violations}, joint=Proportion(1, 1000))
    designs = {"nominal": broken.solution, "robust": good.solution}
    said = verdict(designs, {"nominal": broken, "robust": few})
    assert said.word == "Solved and checked"
    assert "0.100" in said.headline
    assert "of the systems of robust break a limit. For comparison: " in said.headline
    assert "of nominal." in said.headline
    assert "check the margin" not in said.headline
    turned = verdict(designs, {"nominal": few, "robust": broken})
    assert turned.word == "Solved, limits often broken"
    assert "of the systems of robust break a limit: check the margin. For comparison: 0.100" in turned.headline


@pytest.mark.parametrize("write", [number, given_number, percent, residual, count, seconds, values_text])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_written_all_the_same(write, value):
    assert ("–" if math.isnan(value) else "∞") in write(value)
