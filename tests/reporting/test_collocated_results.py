"""Solutions by collocation, as they are saved and tabulated."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import aleator as al
from aleator.reporting._tables import certificate_table, designs_table

COLLOCATED = al.Simultaneous(error=1e-6)


class Block(al.System):
    """A block of uncertain mass that is pushed."""

    states = ("x", "v")
    mass: al.Number = al.parameter("kg")

    def rhs(self, t, z, push):
        return z.v, push / self.mass - jnp.sin(3.0 * z.x)

    def outputs(self, t, z, push):
        return {"x": z.x, "v": z.v, "effort": push**2}


def move(**options):
    return al.Problem(
        Block(al.Uniform(1.0, half_width=0.1)),
        grid=al.Grid(1.0, 6),
        inputs={"push": al.Control(0.0, -20.0, 20.0, degree=1)},
        minimize=al.integral("effort").mean,
        subject_to=[
            al.terminal("x").mean.equals(0.5).named("there"),
            al.terminal("v").mean.equals(0.0).named("at rest"),
            (al.terminal("x").std <= 0.05).named("spread"),
        ],
        expansion=al.Expansion(order=2),
        **options,
    )


@pytest.fixture(scope="module")
def found():
    return al.solve(move(), transcription=COLLOCATED)


def test_states_costates_and_switching_functions_are_saved(found, tmp_path):
    al.reporting.save(tmp_path, design=found)
    data = xr.open_datatree(tmp_path / "results.nc")["design"]
    np.testing.assert_array_equal(data["germ"], found.states.germs)
    for kind, one in (("state", found.states), ("costate", found.costates), ("switching function", found.switching)):
        np.testing.assert_array_equal(data[f"times of {kind}s"], one.times)
        for name, values in one.values.items():
            np.testing.assert_array_equal(data[f"{kind} {name}"], values)


def test_pages_and_files_name_the_scheme_and_not_an_integrator(found, tmp_path):
    al.reporting.save(tmp_path, design=found)
    texts = [xr.open_datatree(tmp_path / "results.nc")["design"].attrs["problem"]]
    al.report(found, path=tmp_path / "page.html")
    texts.append((tmp_path / "page.html").read_text(encoding="utf8"))
    for text in texts:
        assert f"HermiteSimpson on {found.mesh.intervals} intervals" in text
        assert "RungeKutta4" not in text


@pytest.mark.slow
def test_a_front_of_controls_on_different_meshes_is_saved_whole(found, tmp_path):
    front = al.pareto(move(), "spread", [0.05, 0.03], transcription=COLLOCATED)
    fewer = al.pareto(move(), "spread", [0.05], transcription=al.Simultaneous())
    (few,), (many, _) = fewer.points, front.points
    sizes = [one.decisions["inputs.push"].size for one in (few, many)]
    assert sizes[0] < sizes[1]
    mixed = type(front)(**{**vars(front), "points": (few, many)})
    al.reporting.save(tmp_path, front=mixed)
    saved = xr.open_datatree(tmp_path / "results.nc")["front"]["decision inputs.push"].values
    np.testing.assert_array_equal(saved[0][: sizes[0]], few.decisions["inputs.push"])
    assert np.isnan(saved[0][sizes[0] :]).all()
    np.testing.assert_array_equal(saved[1], many.decisions["inputs.push"])


def test_tables_tell_equalities_and_how_states_were_found(found):
    rows = {row[0]: row[1] for row in designs_table({"move": found}, {}).rows}
    assert rows["there: worst value"].startswith("0.50000 = 0.5")
    assert rows["spread: worst value"].split()[1] == "≤"
    states = {row[0]: row[1] for row in certificate_table({"move": found}).rows}["States"]
    assert states == f"variables, {found.mesh.intervals} intervals of {found.mesh.scheme}"


def test_a_limit_that_is_violated_is_not_told_to_be_active(found):
    broken = replace(found.constraints[0], values=found.constraints[0].values + 1.0)
    table = designs_table({"move": replace(found, constraints=(broken, *found.constraints[1:]))}, {})
    rows = {row[0]: row[1] for row in table.rows}
    assert rows["Violated"] == broken.name
    assert broken.name not in rows["Active"]
    assert "Violated" not in [row[0] for row in designs_table({"move": found}, {}).rows]
