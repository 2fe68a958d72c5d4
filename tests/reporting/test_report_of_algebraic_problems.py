import numpy as np
import pytest
import xarray

import aleator as al
from aleator.reporting import save
from algebraic_models import X, tolerance_problem


@pytest.fixture(scope="module")
def results():
    problem = tolerance_problem([X.at_most(1.1, sigmas=1.0), (X.quantile(0.9) <= 2.0).named("chance")])
    solution = al.solve(problem)
    return solution, al.validate(solution, 500)


def test_a_report_of_a_problem_without_time_has_no_time_axes(results, tmp_path):
    solution, evidence = results
    page = al.report(solution, evidence, path=tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Newton" in page
    assert "Time (s)" not in page
    assert "Trajectories" not in page
    assert "Other statistics" in page
    assert "Q0.9[x] (m)" in page


def test_results_of_a_problem_without_time_are_stored_with_units(results, tmp_path):
    solution, evidence = results
    path, _ = save(tmp_path, design=solution, evidence=evidence)
    with xarray.open_datatree(path, engine="h5netcdf") as opened:
        data = opened["design"].to_dataset()
        assert "time" not in data.dims
        assert data["mean x"].attrs["units"] == "m"
        np.testing.assert_array_equal(data["mean x"], solution.moments["x"].mean)
        assert float(data["statistic Q0.9[x]"]) == float(solution.statistics["Q0.9[x]"])
        assert data["statistic Q0.9[x]"].attrs["units"] == "m"
        sampled = opened["evidence"].to_dataset()
        assert float(sampled["sampled Q0.9[x]"]) == evidence.statistics["Q0.9[x]"].estimate
