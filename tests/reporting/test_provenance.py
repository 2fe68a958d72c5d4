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
from aleator.reporting._first_screen import proposal
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
