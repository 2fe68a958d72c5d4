"""Data with seven equal leading digits (NIST StRD, NumAcc3 and NumAcc4), and tables with holes."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import aleator as al

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("base", [1e6, 1e7], ids=["NumAcc3", "NumAcc4"])
def test_certified_moments_of_data_with_equal_leading_digits(base):
    # Of 1001 numbers around base + 0.2, 1000 deviate by 0.1; the certified standard deviation, 0.1, is that with n - 1.
    x = {"x": al.Sample([base + 0.2, *[base + 0.1, base + 0.3] * 500])}
    itself, square, shifted = (
        al.expand(function, x, al.Expansion(order=2))
        for function in (lambda at: at["x"], lambda at: at["x"] ** 2, lambda at: (at["x"] - base) ** 2)
    )
    assert itself.mean == pytest.approx(base + 0.2, rel=1e-15)
    assert itself.std == pytest.approx(0.0999500374687773, rel=1e-6)
    centre, variance = Fraction(base) + Fraction(2, 10), Fraction(10, 1001)
    assert square.mean == pytest.approx(float(centre**2 + variance), rel=1e-15)
    assert shifted.mean == pytest.approx(0.04 + 10 / 1001, rel=1e-6)


HOLES = {"NaN": "received nan at t = 1 s", "": "received nan at t = 1 s", "NA": "row 2: .*'NA'"}


@pytest.mark.parametrize("hole", HOLES)
def test_a_signal_with_a_hole_is_refused_with_its_instant_or_row(tmp_path: Path, hole: str):
    (tmp_path / "air.csv").write_text(f"t,T\n0,1\n1,{hole}\n2,3\n")
    with pytest.raises(al.ProblemError, match=rf"air\.csv: .*{HOLES[hole]}"):
        al.Tabulated.from_csv(tmp_path / "air.csv", time="t", value="T")


def test_data_with_a_hole_are_refused():
    for hole, said in ((np.nan, "received nan at entry 1"), ("NA", "expected a list or vector of numbers")):
        with pytest.raises(al.ProblemError, match=said):
            al.Sample([1.0, hole, 2.0])


@pytest.fixture
def told(tmp_path: Path):
    """Tells the answers twice the input, of which the second is changed, in some encoding."""

    def tell(second: str, encoding: str = "utf-8"):
        asked = al.foreign.ask({"x": al.Uniform(0.0, half_width=1.0)}, al.Expansion(order=1, tolerance=10.0))
        rows = [f"{i},{x!r},{2 * x!r}" for i, x in enumerate(asked.points["x"].tolist(), 1)]
        rows[1] = rows[1].rpartition(",")[0] + f",{second}"
        text = "\n".join(["sample,x,y,comment", *(f"{row},20 °C" for row in rows)])
        (tmp_path / "answers.csv").write_text(text, encoding=encoding)
        return asked.tell(tmp_path / "answers.csv")["y"], asked.points["x"]

    return tell


def test_an_answer_that_is_missing_is_refused_and_a_number_that_stands_for_none_is_taken(told):
    for hole in ("NaN", ""):
        with pytest.raises(al.SimulationError, match=r"first sample 2 \(x=.*has no response"):
            told(hole)
    with pytest.raises(al.ProblemError, match=r"row 2: .*'NA'"):
        told("NA")
    expanded, _ = told("-9999")
    assert expanded.mean < -1000


def test_answers_are_read_in_utf_8_with_and_without_a_mark_and_refused_in_another_encoding(told):
    second = repr(2 * float(told("0")[1][1]))
    for encoding in ("utf-8", "utf-8-sig"):
        assert told(second, encoding)[0].std == pytest.approx(2 / np.sqrt(3), rel=1e-12)
    with pytest.raises(al.ProblemError, match=r"answers\.csv: expected text in UTF-8; received the byte 0xb0"):
        told(second, "latin-1")
