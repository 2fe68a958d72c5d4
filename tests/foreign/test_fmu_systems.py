"""The equations of an FMU as a system, integrated and differentiated here."""

import shutil

import jax
import numpy as np
import pytest

import aleator as al
from compiling import compiled
from rod_models import Rod
from rods import here
from test_documents import code_of
from zoo import cases

GRID = al.Grid(1.0, 20)


@pytest.mark.parametrize("version", cases([2, 3]))
def test_a_system_of_an_fmu_moves_as_the_same_system_written_here_to_rounding(rods, version):
    system = al.foreign.FmuSystem(here(rods(version)), {"damping": 0.2, "rod.length": 1.1, "angle": 0.7})
    assert system.states == ("angle", "rate")
    assert system.units == {"angle": "rad", "rate": "rad/s", "energy": "J"}
    torque = {"torque": al.Tabulated([0.0, 1.0], [0.0, 1.0])}
    found, expected = al.simulate(system, GRID, torque), al.simulate(Rod(0.2, 1.1, 0.7), GRID, torque)
    for name, values in found.items():
        assert np.asarray(values) == pytest.approx(np.asarray(expected[name]), abs=1e-13)


def test_a_system_of_an_fmu_is_differentiated_like_the_same_system_written_here(rods):
    fmu = here(rods(3))

    def by_fmu(damping, length, angle, t_final):
        system = al.foreign.FmuSystem(fmu, {"damping": damping, "rod.length": length, "angle": angle})
        return al.simulate(system, grid(t_final), only=["energy"])["energy"][-1]

    def by_rod(damping, length, angle, t_final):
        return al.simulate(Rod(damping, length, angle), grid(t_final), only=["energy"])["energy"][-1]

    def grid(t_final):
        held = al.Grid(1.0, 5)
        object.__setattr__(held, "t_final", t_final)
        return held

    at = (0.2, 1.1, 0.7, 1.0)
    found, expected = (compiled(jax.jacfwd(one, argnums=(0, 1, 2, 3)))(*at) for one in (by_fmu, by_rod))
    assert np.asarray(found) == pytest.approx(np.asarray(expected), abs=1e-9)


def test_second_derivatives_of_rates_are_those_of_the_closed_form(rods):
    system = al.foreign.FmuSystem(here(rods(3)))
    curvature = compiled(jax.jacfwd(jax.jacfwd(lambda angle: system.rhs(0.0, (angle, 0.3))[1])))(1.0)
    assert float(curvature) == pytest.approx(1.5 * 9.81 * np.sin(1.0), abs=1e-7)


def test_a_system_begins_where_the_fmu_does_whatever_moved_before(rods):
    fmu = here(rods(3))
    al.simulate(al.foreign.FmuSystem(fmu, {"damping": 0.2}), GRID)
    again = al.foreign.FmuSystem(fmu, {"damping": 0.2})
    assert again._equations.start == pytest.approx([1.0, 0.0], abs=0.0)
    assert float(again.initial()["angle"]) == 1.0


def test_what_is_no_system_is_refused(rods):
    for fmu, words in (
        (here(rods(3, wall=True)), r"'rod3_wall_mc' has 1 event indicator\. Use FmuSimulation"),
        (
            here(rods(3), settings={"behaviour": 7}),
            r"those of 'rod3_mc' depend on where it was before, by .* Use Fmu",
        ),
        (here(rods(3), kind="co-simulation"), "gives the rates of its states; 'rod3_mc' is used for co-simulation"),
    ):
        with pytest.raises(al.ProblemError, match=words):
            al.foreign.FmuSystem(fmu)


def test_where_an_fmu_fails_a_system_has_no_numbers_and_says_why(rods):
    fmu = here(rods(3), settings={"behaviour": 1})
    system = al.foreign.FmuSystem(fmu, {"fail_at": 0.5})
    with pytest.warns(al.SimulationWarning) as said:
        found = al.simulate(system, GRID, only=["angle"])["angle"]
    assert np.isfinite(found[9])
    assert np.isnan(found[-1])
    texts = [str(one.message) for one in said]
    assert any("FMU 'rod3_mc' failed at t = 0.5 s: the hinge is broken" in text for text in texts)
    assert any("output 'angle' is not finite" in text for text in texts)


@pytest.mark.slow
def test_the_page_on_fmus_runs(rods, tmp_path, monkeypatch, capsys):
    shutil.copy(rods(3), tmp_path / "pendulum.fmu")
    monkeypatch.chdir(tmp_path)
    # A class in it looks its globals up, as in a script.
    script = tmp_path / "shown.py"
    script.write_text(code_of("docs/fmu.md"))
    exec(compile(script.read_text(), str(script), "exec"), {"__name__": "shown"})
    assert "status       solved" in capsys.readouterr().out
