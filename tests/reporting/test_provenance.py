"""Each number of a page can be traced to its run: designs by digests, evidence by its seed, all by versions."""

import json
from dataclasses import replace
from importlib import metadata

import numpy as np
import pytest
import report_problems as given
import xarray

import aleator as al
from aleator.reporting import design_digest, page_html, provenance, report, save
from aleator.reporting._page import Page
from aleator.reporting._verdict import verdict


@pytest.fixture(scope="module")
def section():
    return provenance(
        {
            "designs": {"robust": given.solution()},
            "evidence": given.evidence(),
            "front": given.front(),
            "margin": given.calibration(),
            "missing": None,
        }
    )


def rows(section):
    return {row[0]: row[1:] for row in section.blocks[0].rows}


def test_a_digest_changes_with_decisions_and_equations_and_with_nothing_else():
    one = given.solution()
    moved = replace(one, vector=np.asarray(one.vector) * (1 + 1e-15))
    other = replace(one, problem=given.problem(0.3))
    assert design_digest(moved) != design_digest(one)
    assert design_digest(al.solve(given.problem(0.2))) == design_digest(one)
    assert design_digest(other) == design_digest(one), "a limit is no equation: its design and objective are the same"
    assert design_digest(replace(one, problem=other_equations())) != design_digest(one)


def other_equations():
    class Stiffer(given.Oscillator):
        def rhs(self, t, z):
            return z.v, -2 * self.k * z.x - self.c * z.v

    asked = given.problem(0.2)
    model = Stiffer(k=al.Uniform(4.0, half_width=0.4), c=al.Uniform(al.Decision(1.0, 0.2, 3.0), half_width=0.1))
    return al.Problem(
        model,
        grid=al.Grid(t_final=4.0, steps=50),
        minimize=al.integral("effort").mean,
        subject_to=list(asked.constraints),
        expansion=al.Expansion(order=2),
    )


def test_each_result_has_its_digest_its_seed_and_its_time(section):
    found, evidence = rows(section), given.evidence()
    assert found["designs: robust"][0] == design_digest(given.solution())
    assert found["evidence"][:3] == [
        design_digest(evidence.solution),
        f"{evidence.samples} fresh systems",
        str(evidence.seed),
    ]
    assert found["front"][1].startswith(f"{len(given.front().solutions)} designs: ")
    assert found["margin"][0] == design_digest(given.calibration().solution)
    assert "missing" not in found


def test_versions_machine_and_lines_to_sign_are_on_the_page(section, tmp_path):
    shown = page_html(Page("Title", "", verdict({"a": given.solution()}, {}), [section]))
    assert f"jax {metadata.version('jax')}" in shown
    assert f"casadi {metadata.version('casadi')}" in shown
    assert "Signature" in shown
    written = report(given.solution(), given.evidence(), path=tmp_path / "one.html").read_text(encoding="utf-8")
    assert design_digest(given.solution()) in written


def test_the_files_of_a_run_carry_the_same_digest_and_versions(tmp_path):
    results, designs = save(tmp_path, design=given.solution())
    assert json.loads(designs.read_text())["design"]["digest"] == design_digest(given.solution())
    with xarray.open_datatree(results, engine="h5netcdf") as tree:
        assert tree.attrs["aleator"] == al.__version__
