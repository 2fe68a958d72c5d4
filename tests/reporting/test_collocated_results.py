"""Solutions by collocation, as they are saved and tabulated."""

from dataclasses import replace

import numpy as np
import pytest
import report_problems as given
import xarray as xr

import aleator as al
from aleator.reporting._tables import certificate_table, designs_table


@pytest.fixture(scope="module")
def found():
    return given.collocated()


def test_pages_and_files_hold_states_costates_meshes_and_the_scheme_and_no_integrator(found, tmp_path):
    al.reporting.save(tmp_path, design=found)
    page = al.report(found, path=tmp_path / "page.html").read_text(encoding="utf8")
    with xr.open_datatree(tmp_path / "results.nc", engine="h5netcdf") as tree:
        data = tree["design"].to_dataset().load()
    np.testing.assert_array_equal(data["germ"], found.states.germs)
    for kind, one in (("state", found.states), ("costate", found.costates), ("switching function", found.switching)):
        np.testing.assert_array_equal(data[f"times of {kind}s"], one.times)
        for name, values in one.values.items():
            np.testing.assert_array_equal(data[f"{kind} {name}"], values)
    np.testing.assert_array_equal(data["mesh 1"], found.meshes[0].nodes)
    np.testing.assert_array_equal(data["mesh 2 drift"], found.meshes[1].drifts)
    assert "Meshes of design" in page
    for text in (page, data.attrs["problem"]):
        assert f"HermiteSimpson on {found.mesh.intervals} intervals" in text
        assert "RungeKutta4" not in text


def test_a_front_of_controls_on_different_meshes_is_saved_whole(found, tmp_path):
    few = replace(found, decisions={**found.decisions, "inputs.push": found.decisions["inputs.push"][:3]})
    front = al.results.Front("spread", np.array([0.05, 0.03]), (few, found))
    al.reporting.save(tmp_path, front=front)
    with xr.open_datatree(tmp_path / "results.nc", engine="h5netcdf") as tree:
        saved = tree["front"]["decision inputs.push"].values
    np.testing.assert_array_equal(saved[0][:3], few.decisions["inputs.push"])
    assert np.isnan(saved[0][3:]).all()
    np.testing.assert_array_equal(saved[1], found.decisions["inputs.push"])


def test_tables_tell_equalities_what_is_violated_and_how_states_were_found(found):
    rows = {row[0]: row[1] for row in designs_table({"move": found}, {}).rows}
    assert rows["there: worst value"].startswith("0.50000 = 0.5")
    assert rows["spread: worst value"].split()[1] == "≤"
    assert "Violated" not in rows
    states = {row[0]: row[1] for row in certificate_table({"move": found}).rows}["States"]
    assert states == f"variables, {found.mesh.intervals} intervals of {found.mesh.scheme}"
    broken = replace(found.constraints[0], values=found.constraints[0].values + 1.0)
    table = designs_table({"move": replace(found, constraints=(broken, *found.constraints[1:]))}, {})
    rows = {row[0]: row[1] for row in table.rows}
    assert rows["Violated"] == broken.name
    assert broken.name not in rows["Active"]
