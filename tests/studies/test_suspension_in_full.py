"""The suspension study from end to end, as a user runs it. Slow."""

import json
import resource
import sys
from pathlib import Path

import pytest
import xarray
from typer.testing import CliRunner

import aleator as al
from aleator import cli
from aleator._core.progress import silent
from aleator.studies.suspension import robust_problem
from aleator.studies.suspension._run import BUILT, TARGET, Effort, SuspensionResults, calibrate_designs
from zoo import oscillator_problem

pytestmark = pytest.mark.slow


def test_the_quick_run_writes_a_report_and_results_that_agree_with_the_library(tmp_path: Path):
    result = CliRunner().invoke(cli.application, ["run", "suspension", "--quick", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert "wrote" in result.output
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for number in ("6.2", "6.4", "6.5", "6.6", "6.7", "6.8", "6.9", "6.10", "7.2", "7.3", "7.5"):
        assert f"Figure {number}" in page
    designs = json.loads((tmp_path / "designs.json").read_text(encoding="utf-8"))
    assert {"designs/dOpt", "designs/uOpt", "designs/aOpt"} <= set(designs)
    stored = xarray.open_datatree(tmp_path / "results.nc", engine="h5netcdf")
    assert float(stored["designs/uOpt"]["objective"]) == pytest.approx(al.solve(robust_problem()).objective, rel=1e-8)
    stored.close()


def test_the_designs_to_build_keep_their_limits_on_cars_of_another_sample():
    results = SuspensionResults(Effort(calibration_samples=5_000))
    calibrate_designs(results, silent)
    for name, limits in BUILT.items():
        found = results.built[name]
        assert found.confirmed
        fresh = al.validate(found.solution, 20_000, seed=123)
        assert fresh.violation(*limits).upper <= TARGET
        assert fresh.joint == fresh.violation(*limits)


@pytest.mark.skipif(sys.platform == "win32", reason="resource limits are read on Unix only")
def test_memory_does_not_grow_with_the_number_of_samples():
    solution = al.solve(oscillator_problem())
    al.validate(solution, 2_000)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    evidence = al.validate(solution, 200_000)
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * (1 if sys.platform == "darwin" else 1024)
    # Kept for percentiles and counts: a functional and two sides of a limit, 8 bytes each; whole histories of all
    # systems would take 390 MB.
    assert grown < 100e6
    assert evidence.samples == 200_000
