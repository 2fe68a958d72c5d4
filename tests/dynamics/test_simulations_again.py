"""One program serves the same equations with any numbers; what the numbers themselves forbid is refused as before."""

from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import numpy as np
import pandas as pd
import pytest

import aleator as al
from aleator.dynamics._simulation import _HISTORY
from tiny_models import Decay

GRID = al.Grid(1.0, 20)
PUSH = 1.0


class Branching(al.System):
    """`x' = -rate x`, written with `if` on a number, which a program for any numbers cannot have."""

    states = ("x",)
    rate: float

    def rhs(self, t, z):
        return (-self.rate * z.x if self.rate > 0 else 0.0 * z.x,)

    def outputs(self, t, z):
        return {"x": z.x}

    def initial(self):
        return {"x": 1.0}


class Pushed(Branching):
    """`x' = PUSH`, which the code reads from a global name."""

    def rhs(self, t, z):
        return (PUSH + 0.0 * z.x,)


class Swing(al.Multibody):
    """A pendulum with a damper."""

    damping: al.Number

    def bodies(self):
        joint = al.joints.Revolute("y", damping=self.damping)
        return (al.Body("arm", joint=joint, mass=1.0, center=(0.0, 0.0, -1.0)),)


@pytest.mark.parametrize("integrator", [al.integrators.RungeKutta4(), al.integrators.Tsit5(rtol=1e-10, atol=1e-12)])
def test_other_numbers_need_no_other_program(integrator):
    before = _HISTORY.compilations
    for rate, start, end in ((1.0, 2.0, 1.0), (0.3, -1.0, 2.5), (2.0, 0.5, 0.7)):
        found = al.simulate(Decay(rate, start), al.Grid(end, 20), integrator=integrator)
        np.testing.assert_allclose(found["x"], start * np.exp(-rate * np.linspace(0.0, end, 21)), rtol=1e-4, atol=1e-9)
    assert _HISTORY.compilations - before == 1


def test_a_number_that_code_branches_on_is_taken_as_it_is():
    np.testing.assert_allclose(al.simulate(Branching(2.0), GRID)["x"][-1], np.exp(-2.0), rtol=1e-5)
    np.testing.assert_array_equal(al.simulate(Branching(-2.0), GRID)["x"], np.ones(21))


def test_what_the_code_reads_may_change(monkeypatch):
    assert float(al.simulate(Pushed(0.0), GRID)["x"][-1]) == pytest.approx(2.0)
    monkeypatch.setattr("test_simulations_again.PUSH", 3.0)
    assert float(al.simulate(Pushed(0.0), GRID)["x"][-1]) == pytest.approx(4.0)


class FromFile(Branching):
    """`x' = k`, with `k` from a file that the code reads in some way."""

    read: Callable[[Path], float]
    path: Path = eqx.field(static=True)

    def rhs(self, t, z):
        return (self.read(self.path) + 0.0 * z.x,)


READERS = {
    "text": lambda path: float(path.read_text()),
    "bytes": lambda path: float(path.read_bytes()),
    "open": lambda path: float(open(path).read()),  # noqa: SIM115, PTH123
    "a table": lambda path: float(np.loadtxt(path)),
    "numbers": lambda path: float(np.fromfile(path, sep=" ")[0]),
    "pandas": lambda path: float(pd.read_csv(path, header=None)[0][0]),
}


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("way", READERS)
def test_a_file_that_the_code_reads_may_change(way, tmp_path):
    path = tmp_path / "k.txt"
    model = FromFile(0.0, READERS[way], path)
    for number in (1.0, 2.0):
        path.write_text(f"{number}\n")
        assert float(al.simulate(model, GRID)["x"][-1]) == pytest.approx(1.0 + number)


def test_impossible_numbers_are_refused_though_the_program_is_there():
    assert np.isfinite(al.simulate(al.ForwardDynamics(Swing(0.1), start={"arm": 0.1}), GRID)["arm"]).all()
    with pytest.raises(al.ProblemError, match=r"expected a damping that is not negative; received -0.1"):
        al.simulate(al.ForwardDynamics(Swing(-0.1), start={"arm": 0.1}), GRID)
    with pytest.raises(al.ProblemError, match=r"'system.start': expected numbers; received nan"):
        al.simulate(Decay(1.0, np.nan), GRID)
