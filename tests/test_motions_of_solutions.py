"""Motions of a solution, its signals and random systems at it: against the closed form of a free mass."""

import math
from typing import ClassVar

import jax
import numpy as np
import pytest
import xarray

import aleator as al
from compiling import compiled
from zoo import cases

HALF = 0.1


class Cart(al.System):
    states = ("x", "v")
    units: ClassVar = {"x": "m", "v": "m/s", "force": "N"}
    m: al.Number = al.parameter("kg", positive=True)

    def initial(self):
        return {"x": 0.0, "v": 0.0}

    def rhs(self, t, z, force):
        return z.v, force / self.m

    def outputs(self, t, z, force):
        return {"x": z.x, "momentum": self.m * z.v}


def problem(m=None):
    force = al.Tabulated(np.linspace(0.0, 1.0, 5), al.Decision([4.0, 2.0, 0.0, -2.0, -4.0], -10.0, 10.0))
    return al.Problem(
        Cart(al.Uniform(1.0, half_width=HALF) if m is None else m),
        grid=al.Grid(1.0, 20),
        inputs={"force": force},
        minimize=al.terminal("x").std,
        subject_to=[al.terminal("x").mean.equals(1.0), al.terminal("momentum").mean.equals(0.0)],
        expansion=al.Expansion(order=6),
    )


# The mean of 1/m and its standard deviation, of m uniform on 1 ± 0.1.
MEAN = math.log((1 + HALF) / (1 - HALF)) / (2 * HALF)
SPREAD = math.sqrt(1 / (1 - HALF**2) - MEAN**2)


@pytest.mark.parametrize("transcription", cases([al.Sequential(), al.Simultaneous()]))
def test_motions_are_those_of_each_system_of_the_expansion(transcription, tmp_path):
    solution = al.solve(problem(), transcription=transcription)
    assert solution.ok
    x, v, force = solution.outputs["x"], solution.states["v"], solution.inputs["force"]
    course = x.systems * x.m  # the same for every system
    assert np.ptp(course.values, axis=0).max() < 1e-9
    np.testing.assert_allclose(x["mean"], MEAN * course[0], atol=1e-9)
    np.testing.assert_allclose(x["std"], SPREAD * course[0], atol=1e-8)
    np.testing.assert_allclose(solution.outputs["momentum"].systems, v.systems * v.m, atol=1e-12)
    assert x.time.values[[0, -1]].tolist() == [0.0, 1.0]
    assert (x["mean"].units, v["mean"].units, force["mean"].units) == ("m", "m/s", "N")
    np.testing.assert_allclose(force["std"], 0.0)
    values = solution.decisions["inputs.force.values"]
    np.testing.assert_allclose(force["mean"], np.interp(force.time, np.linspace(0, 1, 5), values), atol=1e-12)

    solution.outputs.to_netcdf(tmp_path / "motion.nc")
    with xarray.open_dataset(tmp_path / "motion.nc", group="x", engine="h5netcdf") as written:
        np.testing.assert_array_equal(written.systems, x.systems)
    solution.states.to_csv(tmp_path / "motion.csv")
    table = np.genfromtxt(tmp_path / "motion.csv", delimiter=",", names=True)
    assert (tmp_path / "motion.csv").read_text().startswith("time (s),x mean (m),x std (m),v mean (m/s),v std (m/s)\n")
    np.testing.assert_allclose(table["v_mean_ms"], v["mean"], atol=1e-9)
    for write in (solution.outputs.to_netcdf, solution.states.to_csv):
        with pytest.raises(al.ProblemError, match=r"cannot be written .the folder .*missing does not exist"):
            write(tmp_path / "missing" / "motion")


def test_a_signal_of_a_solution_drives_another_simulation():
    solution = al.solve(problem())
    force = solution.signal("force")
    places, forces = (compiled(jax.vmap(solution.signal(name)))(np.array([0.0, 0.125, 1.0])) for name in ("x", "force"))
    assert forces[1] == pytest.approx(np.mean(solution.decisions["inputs.force.values"][:2]))
    found = al.simulate(Cart(2.0), al.Grid(1.0, 20), {"force": force})
    np.testing.assert_allclose(2.0 * np.asarray(found["x"]), solution.outputs["x"]["mean"] / MEAN, atol=1e-9)
    np.testing.assert_allclose(np.asarray(places)[[0, 2]], [0.0, 1.0], atol=1e-9)


@pytest.mark.slow
def test_random_systems_at_a_design_have_its_spread():
    solution = al.solve(al.deterministic(problem()))
    systems = al.simulate_systems(solution, 4000, seed=2)
    x = systems["x"]
    assert x.systems.shape == (4000, 21)
    assert np.abs(x.m - 1).max() <= HALF
    np.testing.assert_allclose(x.systems[:, -1] * x.m, 1.0, atol=1e-9)
    assert float(x["mean"][-1]) == pytest.approx(MEAN, abs=5 * SPREAD / math.sqrt(4000))
    assert float(x["std"][-1]) == pytest.approx(SPREAD, rel=5 / math.sqrt(8000))
    assert solution.outputs["x"].sizes["system"] == 1
