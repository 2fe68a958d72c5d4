"""FMUs that cannot be used, wrong names and numbers, and runs that fail: one sentence each, with the FMU's name."""

import builtins
import zipfile

import numpy as np
import pytest

import aleator as al
from aleator.foreign import _openmdao
from rods import here
from zoo import bar_problem

GRID = al.Grid(2.0, 4)
LONGEST = 400


def refused(error, message, call, *arguments, **named):
    with pytest.raises(error, match=message) as caught:
        call(*arguments, **named)
    assert len(str(caught.value)) < LONGEST


def test_files_that_are_no_fmu_are_refused(rods, tmp_path):
    text, empty = tmp_path / "text.fmu", tmp_path / "empty.fmu"
    text.write_text("a text")
    empty.write_bytes(b"PK\x05\x06" + 18 * b"\0")
    refused(al.ProblemError, "there is no file 'nobody.fmu'", al.foreign.Fmu, "nobody.fmu")
    refused(al.ProblemError, "'text.fmu' is no FMU: expected a zip file", al.foreign.Fmu, text)
    refused(al.ProblemError, "'empty.fmu' is no FMU: expected a modelDescription.xml", al.foreign.Fmu, empty)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("<ModelVariables>", "<ModelVariable>"), "cannot be read: Opening and ending tag"),
        (lambda text: text.replace('Identifier="rod"', 'Identifier="bar"'), r"expected 'bar.*' among its binaries"),
        (lambda text: "<fmiModelDescription/>", "cannot be read: it lacks what FMI requires, such as fmiVersion"),
    ],
    ids=["no XML", "no library", "nothing in it"],
)
def test_descriptions_that_are_wrong_are_refused(rods, change, message):
    refused(al.ProblemError, f"FMU 'wrong': .*{message}", al.foreign.Fmu, rods.changed("wrong", change))


def test_an_fmu_for_another_platform_is_refused(rods):
    path = rods.changed("elsewhere", lambda text: text, at="binaries/riscv-plan9/rod.so")
    message = r"FMU 'elsewhere': expected a binary for this machine, \S+; it has riscv-plan9: export it for"
    refused(al.ProblemError, message, al.foreign.Fmu, path)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("dampin", r"has no variable 'dampin'. Did you mean 'damping'\?"),
        ("der(rate)", "which the FMU computes .causality 'local'"),
        ("behaviour", r"received 'behaviour' of type Int32. Give values of other types once for all in Fmu\(settings"),
    ],
)
def test_names_that_are_no_parameters_are_refused(rods, name, message):
    fmu = here(rods(3))
    refused(al.ProblemError, f"FMU 'rod3_mc'.*{message}", al.foreign.FmuSimulation(fmu, GRID), {name: 1.0})
    refused(al.ProblemError, f"FMU 'rod3_mc'.*{message}", al.foreign.FmuSystem, fmu, {name: 1.0})


def test_outputs_inputs_and_settings_are_checked(rods):
    fmu, ramp, short = here(rods(3)), al.Tabulated([0.0, 2.0], [0.0, 1.0]), al.Tabulated([0.0, 1.0], [0.0, 1.0])

    def run(grid=GRID, **named):
        return al.foreign.FmuSimulation(fmu, grid, **named)

    for words, call in (
        ("received 'damping', whose causality is 'parameter'", lambda: run(inputs={"damping": ramp})),
        ("from 0 to 1 s; expected from 0 to 2 s", lambda: run(inputs={"torque": short})),
        ("given by a signal; leave it out", lambda: run(inputs={"torque": ramp})({"torque": 1.0})),
        ("a whole number for 'behaviour'; received 1.5", lambda: here(rods(3), settings={"behaviour": 1.5})),
        ("True or False for 'started'; received 1", lambda: here(rods(3), settings={"started": 1})),
    ):
        refused(al.ProblemError, words, call)


FAILURES = {
    "fails": (1, r"failed at t = \S+ s: the hinge is broken.*error., with fail_at=0.6"),
    "ends": (2, r"ended the simulation at t = \S+ s, with fail_at=0.6"),
    "no number": (3, r"not finite at t = 0\.6|output 'energy' is nan at t = 1 s, with fail_at=0.6"),
    "no start": (4, "failed to initialise: no position at rest"),
}


@pytest.mark.parametrize(("version", "kind"), [(2, "model exchange"), (3, "co-simulation")])
@pytest.mark.parametrize(("behaviour", "message"), FAILURES.values(), ids=FAILURES)
def test_a_run_that_fails_says_when_and_what_the_fmu_said(rods, version, kind, behaviour, message):
    fmu = here(rods(version), kind=kind, settings={"behaviour": behaviour})
    run = al.foreign.FmuSimulation(fmu, GRID)
    refused(al.SimulationError, f"FMU 'rod{version}_mc'.*{message}", run, {"fail_at": 0.6})
    # Another run begins anew.
    if behaviour != FAILURES["no start"][0]:
        assert np.isfinite(run({"fail_at": 9.0})["angle"]).all()


def test_a_failure_among_uncertain_parameters_names_them(rods):
    fmu = here(rods(3), settings={"behaviour": 1})
    run, uncertain = al.foreign.FmuSimulation(fmu, GRID), {"fail_at": al.Uniform(2.0, half_width=0.5)}
    with pytest.raises(al.SimulationError, match=r"'rod3_mc' raised .* the hinge is broken .* where fail_at=1\."):
        al.expand(run, uncertain, al.Expansion(order=2), traced=False)
    with (
        pytest.warns(al.SimulationWarning, match="FMU 'rod3_mc' failed at .*: the hinge is broken"),
        pytest.raises(al.SimulationError, match="'rod3_mc' is not finite at"),
    ):
        al.expand(run, uncertain, al.Expansion(order=2))


@pytest.mark.parametrize(
    ("package", "extra", "call"),
    [
        ("fmpy", "fmu", lambda: al.foreign.Fmu("pendulum.fmu")),
        ("openmdao", "openmdao", lambda: al.foreign.openmdao_component(bar_problem())),
    ],
)
def test_without_its_package_the_extra_of_a_format_is_named(package, extra, call, tmp_path, monkeypatch):
    imported = builtins.__import__

    def without(name, *more, **others):
        if name.partition(".")[0] == package:
            raise ImportError(name)
        return imported(name, *more, **others)

    monkeypatch.chdir(tmp_path)
    with zipfile.ZipFile("pendulum.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", '<fmiModelDescription fmiVersion="2.0"/>')
    _openmdao._component.cache_clear()
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(al.MissingExtraError, match=rf"pip install 'aleator\[{extra}\]'"):
        call()
