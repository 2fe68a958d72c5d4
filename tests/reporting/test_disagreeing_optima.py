"""Pages of problems with several optima: what a front and a design found is told side by side."""

import html
import re
from pathlib import Path
from typing import Any

import jax.numpy as jnp

import aleator as al


class TwoBasins(al.AlgebraicSystem):
    """A loss with minima 1 at `a = 1` and 3 at `a = 5`, which meet at `a = 3.25`."""

    a: Any

    def outputs(self):
        return {"loss": jnp.minimum((self.a - 1) ** 2 + 1, (self.a - 5) ** 2 + 3), "a": self.a}


def words(path: Path) -> str:
    """The words of a page, with plain spaces."""
    return re.sub(r"\s+", " ", html.unescape(path.read_text(encoding="utf-8")))


def test_a_page_tells_that_a_front_found_a_better_optimum_than_its_design(tmp_path: Path):
    problem = al.Problem(
        TwoBasins(al.Decision(4.5, 0.0, 8.0)),
        minimize=al.output("loss").mean,
        subject_to=[(al.output("a").mean <= 6.0).named("a")],
    )
    design, front = al.solve(problem), al.pareto(problem, "a", [2.0, 6.0])
    page = words(al.report({"mine": design}, fronts={"mine": front}, path=tmp_path / "page.html"))
    assert "Several local optima." in page
    assert "'mine' and the front at a = 6 are optima of one problem, 3.0000 and 1.0000" in page
    assert "a neighbour led to a better one than the problem's own start" in page
    alone = al.pareto(problem, "a", [6.0])
    page = words(al.report({"mine": design}, fronts={"mine": alone}, path=tmp_path / "page.html"))
    assert "optima" not in page
