"""The suspension study: its model against plain NumPy, its designs against another program, and the whole run."""

import json
from functools import cache

import numpy as np
import pytest
import xarray

import aleator as al
import command_line
from aleator.design import responses
from aleator.studies.suspension import apportionment_problem, deterministic_problem, robust_problem
from aleator.transcription import transcribe
from compiling import compiled
from numpy_quarter_car import quarter_car
from zoo import optimum

PROBLEMS = {"dOpt": deterministic_problem, "uOpt": robust_problem, "aOpt": apportionment_problem}
MEAN, WIDTH = np.array([376.0, 30e3, 2000.0, 1.39, 200e3]), np.array([47.0, 3750.0, 250.0, 0.17375, 25e3])


@cache
def best(name):
    return optimum(PROBLEMS[name]())


def test_an_independent_simulation_reproduces_ride_travel_and_holding():
    problem, germ = robust_problem(), np.random.default_rng(4).uniform(-1, 1, (5, 5))
    functionals = (al.integral("comfort"), al.rms("grip"), al.path("travel"))
    ours = compiled(lambda germ, decisions: responses(problem, functionals, germ, decisions))(germ, MEAN[1:3])
    ride, holding, travel = quarter_car(*(MEAN + WIDTH * germ).T)
    np.testing.assert_allclose(ours[0], ride, rtol=1e-10)
    np.testing.assert_allclose(ours[1], holding, rtol=1e-10)
    np.testing.assert_allclose(ours[2], travel.T, atol=1e-10 * np.abs(travel).max())


def test_the_robust_optimum_is_that_of_an_independent_program():
    # 185.3167 by CasADi's own single shooting, in design.md.
    assert best("uOpt").objective == pytest.approx(185.3167, rel=1e-5)


def test_the_deterministic_optimum_holds_in_an_independent_simulation():
    chosen = best("dOpt").decisions
    ride, holding, travel = quarter_car(376.0, chosen["k_s.mean"], chosen["b_s.mean"], 1.39, 200e3)
    assert best("dOpt").objective == pytest.approx(ride[0], rel=1e-9)
    assert holding[0] == pytest.approx(0.034, rel=1e-6)
    assert np.abs(travel).max() < 0.203


def published_cost(k_s, b_s, eta):
    return 0.5 + 1.40e6 / k_s**1.5 + 0.75 + 3.31e5 / b_s**2 + 0.85 + 0.733 / eta


@pytest.mark.slow
def test_apportionment_saves_what_the_chapter_says_with_the_published_constraints_active():
    start = transcribe(apportionment_problem())
    initial = start.program.evaluate(start.program.start).objective
    assert initial == pytest.approx(published_cost(3750.0, 250.0, 0.17375), rel=1e-12)
    assert initial == pytest.approx(17.71, abs=0.005)
    design = al.solve(apportionment_problem())
    spreads = (design.decisions[f"{name}.half_width"] for name in ("k_s", "b_s", "eta"))
    assert design.objective == pytest.approx(published_cost(*spreads), rel=1e-10)
    assert 1 - design.objective / initial > 0.65
    assert {one.name for one in design.constraints if np.any(one.active)} == {"travel", "ride"}
    assert "k_s.mean" in design.at_bounds
    certificate = design.certificate
    assert max(certificate.violation, certificate.stationarity, certificate.complementarity) < 1e-6


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::aleator.GridWarning")
def test_the_quick_run_writes_a_report_and_results_that_agree_with_the_library(tmp_path, monkeypatch):
    monkeypatch.setattr("aleator.studies.suspension.GRID", al.Grid(2.8, 700))  # a quarter of its steps
    result = command_line.aleator("run", "suspension", "--quick", "--out", str(tmp_path))
    assert result.exit_code == 0, result.output
    assert "wrote" in result.output
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for number in ("6.2", "6.4", "6.5", "6.6", "6.7", "6.8", "6.9", "6.10", "7.2", "7.3", "7.5"):
        assert f"Figure {number}" in page
    designs = json.loads((tmp_path / "designs.json").read_text(encoding="utf-8"))
    assert {"designs/dOpt", "designs/uOpt", "designs/aOpt"} <= set(designs)
    with xarray.open_datatree(tmp_path / "results.nc", engine="h5netcdf") as stored:
        found = float(stored["designs/uOpt"]["objective"])
    assert found == pytest.approx(al.solve(robust_problem()).objective, rel=1e-9)
