"""The page of a report: one file, escaped, whose verdict says what was checked and what was not."""

import re
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser

import numpy as np
import pytest
import report_problems as given

import aleator as al
from aleator import ProblemError
from aleator.reporting import report
from aleator.reporting._first_screen import proposal
from aleator.reporting._numbers import number
from aleator.reporting._tables import designs_table, evidence_table
from aleator.validation import Disagreement
from zoo import MASS, STRESS, TwoBasins, bar_problem


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
    path, name = tmp_path_factory.mktemp("page") / "report.html", "uOpt <i>"
    designs, evidence, fronts = {name: given.solution()}, {name: given.evidence()}, {name: given.front()}
    return report(designs, evidence, fronts, path=path, title="A <script> & title").read_text(encoding="utf-8")


def reported(tmp_path, *arguments, **options):
    """The words of a report."""
    path = report(*arguments, **options, path=tmp_path / "new" / "report.html")
    return Reader(path.read_text(encoding="utf-8"))


def test_the_page_is_one_file_that_names_no_other(page):
    reader = Reader(page)
    assert all(address.startswith(("#", "data:")) for address in reader.addresses)
    assert not re.search(r"@import|url\(\s*['\"]?http", page.split("<body>")[0])
    assert len(page) < 8e6
    assert reader.libraries == 1
    assert page.count("plotly.js v") == 1


def test_names_are_escaped_everywhere(page):
    assert "<title>A &lt;script&gt; &amp; title</title>" in page
    outside = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert "uOpt <i>" not in outside
    assert "reach <b>&" not in outside
    assert "reach &lt;b&gt;&amp;" in outside
    assert not {"i", "b"} & set(Reader(page).tags)


def test_the_page_carries_the_problem_the_certificate_and_how_to_read_it(page):
    text = Reader(page).text
    assert str(given.solution().problem) in text
    for words in ("Stationarity", "Leave-one-out error", "How to read this", "Monte Carlo and the expansion compared"):
        assert words in text


def test_one_solution_is_enough_and_what_is_missing_is_left_out(tmp_path):
    page = reported(tmp_path, given.solution())
    assert "Solved, not checked" in page.text
    assert page.libraries == 0
    assert "Trajectories" not in page.text


def test_an_infeasible_solution_is_named_first_with_the_reason(tmp_path):
    one = given.infeasible()
    text = reported(tmp_path, one).text
    assert "is not solved" in text
    assert text.index("Not solved") < text.index(one.why()) < text.index("Designs")


def test_a_page_tells_that_a_front_found_a_better_optimum_than_its_design(tmp_path):
    limit = (al.output("a").mean <= 6.0).named("a")
    problem = al.Problem(TwoBasins(al.Decision(4.5, 0.0, 8.0)), minimize=al.output("loss").mean, subject_to=[limit])
    design, front = al.solve(problem), al.pareto(problem, "a", [2.0, 6.0])
    said = re.sub(r"\s+", " ", unescape(reported(tmp_path, {"mine": design}, fronts={"mine": front}).text))
    assert "'mine' and the front at a = 6 are optima of one problem, 3.0000 and 1.0000" in said
    assert "a neighbour led to a better one than the problem's own start" in said
    alone = al.results.Front("a", front.values[1:], (design,))
    assert "optima" not in reported(tmp_path, {"mine": design}, fronts={"mine": alone}).text


def test_a_solution_that_fresh_simulations_contradict_is_not_to_be_trusted():
    evidence = given.evidence()
    found = replace(evidence, disagreements=(Disagreement("∫effort dt", 1.0, 2.0, 0.1),))
    said = proposal({"design": evidence.solution}, {"design": found})
    assert (said.level, said.word) == ("bad", "Contradicted")


def test_evidence_on_another_design_is_refused(tmp_path):
    other = given.front().solutions[0]
    strange = replace(given.evidence(), solution=other)
    with pytest.raises(ProblemError, match="evidence on 'design' was sampled from another design"):
        report(given.solution(), strange, path=tmp_path / "page.html")
    with pytest.raises(ProblemError, match="evidence on 'b', but no design of that name"):
        report({"a": other}, {"b": strange}, path=tmp_path / "page.html")
    assert not list(tmp_path.iterdir())


def test_the_verdict_is_on_the_proposed_design_and_tells_the_others_for_comparison():
    often = given.evidence()
    few = replace(often, samples=1000, broken=dict.fromkeys(often.broken, np.arange(1000) < 1))
    designs = {"nominal": often.solution, "robust": often.solution}
    share = 1000 * often.joint.estimate
    said = proposal(designs, {"nominal": often, "robust": few})
    assert (said.level, said.word) == ("good", "Build")
    assert said.headline.startswith(f"Build c.mean {number(often.solution.decisions['c.mean'], 4, 'N s/m')}. ")
    assert f"1 system in 1000 exceeds a limit (target 50), against {share:.0f} for nominal." in said.headline
    assert said.headline.endswith("The objective is the same.")
    turned = proposal(designs, {"nominal": few, "robust": often})
    assert (turned.level, turned.word) == ("caution", "Do not build yet")
    assert f"{share:.0f} systems in 1000 exceed a limit (target 50), against 1 for nominal." in turned.headline
    strict = proposal(designs, {"nominal": often, "robust": few}, target=0.002)
    assert few.joint.upper > 0.002
    assert (strict.level, strict.word) == ("caution", "Do not build yet")
    assert (
        f"1 system in 1000 exceeds a limit, at most {number(1000 * few.joint.upper, 2)} (target 2)" in strict.headline
    )


def test_numbers_are_written_with_four_significant_digits():
    texts = {0.0: "0", 23339.0: "23 339", -0.0322: "−0.03220", 1e-6: "1.00·10⁻⁶", 220.0: "220.0"}
    assert {value: number(value).replace("\u202f", " ") for value in texts} == texts


def test_percentiles_of_a_table_are_those_of_its_heading():
    evidence = al.validate(al.solve(bar_problem()), 2000)
    table = evidence_table({"bar": evidence})
    (row,) = [one for one in table.rows if one[0].startswith("bar, stress")]
    assert table.header[-3:] == ["5 %", "Median", "95 %"]
    expected = np.percentile(evidence.functionals["stress"].values, (5, 50, 95))
    np.testing.assert_allclose([float(one) for one in row[-3:]], expected, rtol=2e-3)


def test_of_several_limits_of_one_name_the_worst_is_shown():
    limits = [(STRESS.mean <= 5.0).named("stress"), *bar_problem().constraints]
    found = al.solve(al.Problem(bar_problem().system, minimize=MASS.mean, subject_to=limits))
    rows = {row[0]: row[1] for row in designs_table({"bar": found}, {}).rows}
    assert rows["stress: worst value"].endswith("≤ 0.5")
