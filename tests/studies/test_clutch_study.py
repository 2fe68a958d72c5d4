"""The clutch study: table 7.2, its analysis and its allocation, in small, from stage to page."""

import html
import itertools
import json
import re

import numpy as np
import pytest
import xarray
from scipy import optimize
from typer.testing import CliRunner

import aleator as al
from aleator import cli
from aleator.journalling import FILE
from aleator.reporting import PAGE
from aleator.studies._study import Draft
from aleator.studies.clutch import MEANS, TOLERANCES, clutch, pressure_angle
from aleator.studies.clutch._facts import counted, counts_table, method, rejects_of, times_cheaper, verdict
from aleator.studies.clutch._run import (
    CHEAPEST,
    GIVEN,
    SAFE,
    Effort,
    Method,
    count_rejects,
    exact_rejects,
    exact_variation,
    tolerances_of,
    worst_case,
    worst_case_tolerances,
)
from aleator.studies.clutch._study import ClutchStudy

SMALL = Effort(samples=20_000, quasi_samples=2**11, evidence_samples=20_000, counted=200_000, front_points=3, repeats=1)


@pytest.fixture(scope="module")
def study():
    made = ClutchStudy(SMALL)
    for stage in made.stages:
        made.run(stage)
    return made


@pytest.fixture(scope="module")
def results(study):
    return study.found


def test_the_loop_closes_where_the_closed_form_says_and_its_quadrature_is_the_exact_value():
    nominal = al.references.linearise(lambda realised: al.simulate(realised)["chi"][0], clutch())
    assert float(nominal.mean) == pytest.approx(float(pressure_angle(*MEANS.values())), rel=1e-12)
    assert exact_variation() == pytest.approx(0.6590101, abs=1e-7)


def corners(tolerances):
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    return pressure_angle(*(np.array(list(MEANS.values())) + signs * np.array(list(tolerances.values()))).T)


def test_the_worst_case_is_the_extreme_of_all_corners_of_the_tolerances():
    """The angle is monotone in each dimension, so that no point of the box lies beyond its eight corners."""
    for tolerances in (TOLERANCES, {"a": 0.01, "c": 0.05, "e": 0.03}):
        every = corners(tolerances)
        assert worst_case(tolerances) == pytest.approx((every.min(), every.max()), rel=1e-14)
    counts = count_rejects(TOLERANCES, 1000)
    assert counts.broken() == [6.0]
    assert counts.worst_case == pytest.approx((5.957, 7.938), abs=1e-3)  # cos chi = 39.135 / 39.3475, 39.015 / 39.3925


def test_counted_rejects_are_those_of_the_exact_tails():
    wide = {name: 1.5 * tolerance for name, tolerance in TOLERANCES.items()}
    counts = count_rejects(wide, 2_000_001)  # not a whole number of batches
    assert counts.deviation.either.samples == 2_000_001
    for one, exact in zip((counts.function.low, counts.function.high), exact_rejects(wide), strict=True):
        assert one.lower < exact < one.upper
    low, high = exact_rejects(TOLERANCES)  # one sum of normal parts a limit
    assert (low, high) == pytest.approx((8.2556e-6, 8.3914e-7), rel=1e-3)


def test_the_worst_case_tolerances_are_the_cheapest_that_an_optimiser_finds():
    found = worst_case_tolerances()
    assert worst_case(found)[0] == pytest.approx(6.0, abs=1e-9)
    assert worst_case(found)[1] < 8.0
    limits = {"type": "ineq", "fun": lambda x: 100 * (corners(dict(zip(MEANS, x / 100, strict=True))) - 6.0)}
    start = np.array([2.0, 1.0, 2.0])
    best = optimize.minimize(lambda x: np.sum(100 / x), start, constraints=[limits], bounds=[(0.1, 10)] * 3, tol=1e-9)
    assert best.success
    np.testing.assert_allclose(best.x / 100, list(found.values()), rtol=1e-3)


@pytest.mark.slow
def test_table_7_2_is_reached_at_the_published_points(results):
    published = {"DLM": (0.65788, 5e-6), "gPC, order 3": (0.65900, 1.5e-5), "gPC, order 5": (0.65901, 1.5e-5)}
    for name, (value, tolerance) in {**published, "gPC, order 7": (0.6590101, 1e-7)}.items():
        assert method(results, name).variation == pytest.approx(value, abs=tolerance), name
    assert [method(results, f"gPC, order {order}").points for order in (2, 3, 5)] == [30, 60, 168]
    for name in ("Monte Carlo", "quasi-Monte Carlo"):
        sampled = method(results, name)
        assert abs(sampled.variation - results.exact) < 4.5 * sampled.standard_error
    # Monte Carlo needs a thousand times the effort of order three.
    expanded, sampled = method(results, "gPC, order 3"), method(results, "Monte Carlo")
    calls = sampled.points * (sampled.standard_error / abs(expanded.variation - results.exact)) ** 2
    assert calls > 1000 * expanded.points
    assert times_cheaper(results) > 0


@pytest.mark.slow
def test_the_allocation_follows_the_rule_of_the_linearised_problem(results):
    """Minimising the sum of 1/T at a given variance makes T proportional to |S|^(-2/3)."""
    assert results.allocation.ok
    slopes = {name: one.sensitivity for name, one in results.analyses["deviation"].contributions.items()}
    chosen = tolerances_of(results.allocation)
    scaled = np.array([chosen[name] * abs(slopes[name]) ** (2 / 3) for name in chosen])
    # The angle is slightly skewed, so the rule holds to a part in a hundred.
    np.testing.assert_allclose(scaled, scaled.mean(), rtol=0.01)
    assert results.allocation.objective < 0.65 * sum(1 / one for one in TOLERANCES.values())


@pytest.mark.slow
def test_fresh_assemblies_confirm_the_predicted_rejects(results):
    share, error = counted(results.evidence)
    assert abs(share - rejects_of(results.allocation)) < 4.5 * error
    assert rejects_of(results.allocation) == pytest.approx(results.given, rel=1e-5)
    assert results.front.solved.all()
    assert np.all(np.diff(results.front.objectives) > 0)  # fewer rejects cost more


@pytest.mark.slow
def test_given_and_cheapest_and_safe_tolerances_are_all_counted_and_the_verdict_names_what_to_tighten(results):
    assert set(results.counts) == {GIVEN, CHEAPEST, SAFE}
    rows = {row[0]: row[1:] for row in counts_table(results).rows}
    broken = [one.split(", ")[1] for one in rows["Worst case"]]
    assert broken == ["breaks 6°", "breaks 6° and 8°", "within the limits"]
    for name in (GIVEN, CHEAPEST):
        either = results.counts[name].deviation.either
        share = al.results.Proportion(either.count, either.samples, confidence=0.999)
        assert share.lower < results.given < share.upper
    said = verdict(results)
    assert said.word == "Build"
    assert said.headline.startswith("Tighten the hub a, widen the roller c and ring e")
    assert "the worst case must stay within 6° to 8°" in said.headline
    assert any(one.startswith("The given tolerances") and "breaks 6°" in one for one in said.sentences)


def test_what_the_first_stages_find_is_stored_before_there_is_a_design(tmp_path):
    """Table 7.2 and the counts are no designs; a run that is killed after their stages keeps them as well."""
    study, counts = ClutchStudy(SMALL), count_rejects(TOLERANCES, 1000)
    study.found.methods = [Method("DLM", 0.65, None, 1, 0.1), Method("Monte Carlo", 0.66, 0.01, 200, 0.2)]
    study.found.counts = {GIVEN: counts}
    page = Draft(study)
    for name, result in study.results().items():
        page.keep(name, result)
    page.save(tmp_path)
    with xarray.open_datatree(tmp_path / "results.nc", engine="h5netcdf") as stored:
        found = stored["methods"].to_dataset().sel(row="Monte Carlo")
        assert [float(found[name]) for name in ("three_sigma", "standard_error", "points")] == [0.66, 0.01, 200]
        counted = stored["counts"].to_dataset().sel(tolerances=GIVEN)
        assert int(counted["rejects"].sel(specification="deviation")) == counts.deviation.either.count
        assert counted["worst_case"].values.tolist() == list(worst_case(TOLERANCES))


def aleator(*arguments):
    result = CliRunner().invoke(cli.application, [*map(str, arguments), "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def body(page):
    """A page without the time at which it was written."""
    return re.sub(r"on \d{4}-\d\d-\d\d at \d\d:\d\d", "", page.read_text(encoding="utf-8"))


@pytest.mark.slow
def test_a_case_study_is_written_and_run_again_from_its_folder_alone_also_of_a_run_that_was_killed(tmp_path):
    folder = tmp_path / "clutch"
    aleator("run", "clutch", "--quick", "--out", folder)
    before, page = (folder / FILE).read_bytes(), body(folder / PAGE)
    assert aleator("report", folder, "--out", tmp_path / PAGE)["missing"] == []
    assert (folder / FILE).read_bytes() == before
    assert body(tmp_path / PAGE) == page
    done = {json.loads(line)["key"] for line in before.decode().splitlines() if '"state": "done"' in line}
    assert aleator("run", "clutch", "--quick", "--out", folder)["recalled"] == len(done)
    assert body(folder / PAGE) == page
    # Killed after its first stage.
    (folder / PAGE).unlink()
    lines = before.decode().splitlines(keepends=True)
    (folder / FILE).write_text("".join(lines[: next(i for i, one in enumerate(lines) if "work tolerances" in one)]))
    found = aleator("report", folder)
    assert found["missing"] == [
        "'tolerances' is not finished, nor what follows it: work tolerances, limits is missing.",
    ]
    assert found["verdict"].startswith("The study was stopped")
    assert "in 'tolerances'; what follows it is missing." in html.unescape(body(folder / PAGE))
    assert "gPC, order 3" in body(folder / PAGE)
