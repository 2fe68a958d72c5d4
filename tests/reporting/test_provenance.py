"""Each number of a page can be traced to its run: designs by digests, evidence by its seed, all by versions."""

import json
from dataclasses import replace
from importlib import metadata
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
import report_problems as given
import xarray

import aleator as al
from aleator.reporting import design_digest, page_html, provenance, report, save
from aleator.reporting._first_screen import proposal
from aleator.reporting._numbers import unit_of, unit_of_decision, units_of_moments
from aleator.reporting._page import Page


@pytest.fixture(scope="module")
def section():
    results = {"evidence": given.evidence(), "front": given.front(), "margin": given.calibration(), "missing": None}
    return provenance({"designs": {"robust": given.solution()}, **results})


class Stiffer(given.Oscillator):
    """The same numbers in other equations."""

    def rhs(self, t, z):
        return z.v, -2 * self.k * z.x - self.c * z.v


def test_a_digest_changes_with_decisions_and_equations_and_with_nothing_else():
    one, problem = given.solution(), given.problem(0.2)
    digest = design_digest(one)
    assert design_digest(replace(one, vector=np.asarray(one.vector) * (1 + 1e-15))) != digest
    assert design_digest(replace(one, problem=problem)) == digest
    assert design_digest(replace(one, problem=given.problem(0.3))) == digest, "a limit is no equation"
    other = al.Problem(
        Stiffer(k=problem.system.k, c=problem.system.c),
        grid=problem.grid,
        minimize=al.integral("effort").mean,
        subject_to=list(problem.constraints),
        expansion=problem.expansion,
    )
    assert design_digest(replace(one, problem=other)) != digest


def test_each_result_has_its_digest_its_seed_and_its_time(section):
    found, evidence = {row[0]: row[1:] for row in section.blocks[0].rows}, given.evidence()
    assert found["designs: robust"][0] == design_digest(given.solution())
    sampled = [design_digest(evidence.solution), f"{evidence.samples} fresh systems", str(evidence.seed)]
    assert found["evidence"][:3] == sampled
    assert found["front"][1].startswith(f"{len(given.front().solutions)} designs: ")
    assert found["margin"][0] == design_digest(given.calibration().solution)
    assert "missing" not in found


def test_pages_and_files_carry_versions_digests_and_lines_to_sign(section, tmp_path):
    shown = page_html(Page("Title", "", proposal({"a": given.solution()}, {}), [section]))
    for said in (f"jax {metadata.version('jax')}", f"casadi {metadata.version('casadi')}", "Signature"):
        assert said in shown
    digest = design_digest(given.solution())
    page = report(given.solution(), given.evidence(), path=tmp_path / "one.html")
    assert digest in page.read_text(encoding="utf-8")
    results, designs = save(tmp_path, design=given.solution())
    assert json.loads(designs.read_text())["design"]["digest"] == digest
    with xarray.open_datatree(results, engine="h5netcdf") as tree:
        assert tree.attrs["aleator"] == al.__version__


# --- Units of functionals, statistics and expressions, by dimensional analysis on paper -------------------------------


ENDS = {"start": ((0.0, 0.0), 0), "end": ((1.0, 1.0), 0)}


class Crane(al.Mechanical):
    """A trolley and a winch: one joint that slides and one that turns; `temperature` has no unit."""

    names = ("x", "q")
    units: ClassVar = {
        **{"x": "m", "x_rate": "m/s", "x_torque": "N", "q": "rad", "q_rate": "rad/s", "q_torque": "N m"},
        **{"drive": "W", "stored": "J", "jerk": "m/s³", "share": "-"},
    }
    mass: al.Number = al.parameter("kg", positive=True)

    def mass_matrix(self, q: Any) -> Any:
        return self.mass * jnp.eye(2)

    def coriolis(self, q: Any, v: Any) -> Any:
        return jnp.zeros((2, 2))

    def outputs(self, motion: Any) -> dict[str, Any]:
        one = motion.q[0]
        return dict.fromkeys(("drive", "stored", "jerk", "share", "temperature"), one)


@pytest.fixture(scope="module")
def crane() -> al.Problem:
    objective = al.objectives.effort("x_torque") + al.objectives.power({"q_torque": "q_rate"})
    motion = al.BSpline(al.Decision(np.full((4, 2), 0.5), -5.0, 5.0), **ENDS)
    mass = al.Gamma(shape=al.Decision(4.0, 3.0, 5.0), scale=al.Decision(0.5, 0.1, 1.0), lower=0.1)
    grid = al.Grid(al.Decision(2.0, 1.0, 3.0), 4)
    return al.Problem(al.InverseDynamics(Crane(mass=mass), motion=motion), grid=grid, minimize=objective)


X, Q = al.path("x_torque"), al.path("q_torque")


UNITS = [
    (al.objectives.effort("x_torque"), "N² s"),
    (al.objectives.power({"q_torque": "q_rate", "x_torque": "x_rate"}), "J"),
    (al.objectives.power({"q_torque": "x_rate"}), "N m (m/s) s"),
    (al.objectives.coefficient_power({"q_torque": "q_rate"}), "J"),
    (al.objectives.torque_rate("x_torque"), "(N/s)² s"),
    (al.path("q_torque_rate").std, "N m/s"),
    (al.objectives.terminal_variance("x"), "m²"),
    (al.objectives.terminal_variance("x", "x_rate"), ""),
    (al.objectives.terminal_mean_error({"x": 1.0}), "m"),
    (al.objectives.final_time(), "s"),
    (al.objectives.effort("x_torque") + al.objectives.final_time(), ""),
    (al.objectives.effort("x_torque") + 0 * al.objectives.final_time(), "N² s"),
    (al.time_integral(X.std), "N s"),
    (al.time_integral(al.correlation(X, Q)), "s"),
    (al.time_integral(al.covariance(X, al.path("x_rate"))), "J"),
    (al.rms("x_torque").mean + 2 * al.rms("x_torque").std - 1.0, "N"),
    (al.peak("x_rate").quantile(0.9), "m/s"),
    (al.integral("drive").mean, "J"),
    (al.integral("share").mean, "s"),
    (al.integral("temperature").mean, ""),
    (al.objectives.power({"x_torque": "temperature"}), ""),
    (al.value("mass.mean"), "kg"),
    (al.value("mass.scale") + al.value("mass.std"), "kg"),
    (al.terminal("x").mean + al.cost.reciprocal("mass.std", bias=0.0, scale=1.0), ""),
]


def test_units_follow_from_those_of_outputs(crane):
    assert {str(one): unit_of(one, crane) for one, _ in UNITS} == {str(one): unit for one, unit in UNITS}


def test_functionals_and_decisions_have_their_units(crane):
    assert units_of_moments(crane) == {"∫x_torque² dt": "N² s", "∫|q_torque q_rate| dt": "J"}
    found = {name: unit_of_decision(name, crane) for name in crane.placements.decisions}
    assert found == {"mass.shape": "", "mass.scale": "kg", "motion.free": "", "t_final": "s"}
