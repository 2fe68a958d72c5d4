"""Wrong names of parameters of FMUs, and runs that fail: one sentence each, with the FMU's name."""

import zipfile

import numpy as np
import pytest

import aleator as al
from rods import here, platform

GRID = al.Grid(2.0, 4)
LONGEST = 400


def refused(error, message, call, *arguments, **named):
    with pytest.raises(error, match=message) as caught:
        call(*arguments, **named)
    assert len(str(caught.value)) < LONGEST


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("dampin", r"has no variable 'dampin'. Did you mean 'damping'\?"),
        ("der(rate)", "which the FMU computes .causality 'local'"),
    ],
)
def test_names_that_are_no_parameters_are_refused(rods, name, message):
    fmu = here(rods(3))
    refused(al.ProblemError, f"FMU 'rod3_mc'.*{message}", al.foreign.FmuSimulation(fmu, GRID), {name: 1.0})
    refused(al.ProblemError, f"FMU 'rod3_mc'.*{message}", al.foreign.FmuSystem, fmu, {name: 1.0})


@pytest.mark.parametrize(
    ("version", "name", "value"),
    [(2, "started", "no"), (3, "started", "no"), (2, "behaviour", 1.5), (3, "behaviour", 2**32), (3, "damping", "0.1")],
)
def test_a_setting_of_another_type_is_refused_which_an_fmu_would_take_for_something_else(rods, version, name, value):
    message = f"FMU 'rod{version}_mc': '{name}': expected a value of FMI's type .*; received {value!r}"
    refused(al.ProblemError, message, here, rods(version), settings={name: value})


def test_an_fmu_without_a_binary_for_this_machine_says_for_which_it_has_one(rods, tmp_path):
    path = tmp_path / "away.fmu"
    with zipfile.ZipFile(rods(2)) as given, zipfile.ZipFile(path, "w") as archive:
        for name in given.namelist():
            archive.writestr(name.replace(platform(2), "win64/rod.dll"), given.read(name))
    refused(al.ProblemError, "FMU 'away': expected a binary for this machine.* it has win64: export", here, path)


FMI2, FMI3 = (2, "model exchange"), (3, "co-simulation")
FAILURES = [
    (1, *FMI2, r"failed at t = \S+ s: the hinge is broken.*error., with fail_at=0.6"),
    (1, *FMI3, r"failed at t = \S+ s: the hinge is broken.*error., with fail_at=0.6"),
    (2, *FMI3, r"ended the simulation at t = \S+ s, with fail_at=0.6"),
    (3, *FMI2, r"not finite at t = 0\.6"),
    (4, *FMI2, "failed to initialise: no position at rest"),
]


@pytest.mark.parametrize(("behaviour", "version", "kind", "message"), FAILURES)
def test_a_run_that_fails_says_when_and_what_the_fmu_said(rods, behaviour, version, kind, message):
    fmu = here(rods(version), kind=kind, settings={"behaviour": behaviour})
    run = al.foreign.FmuSimulation(fmu, GRID)
    refused(al.SimulationError, f"FMU 'rod{version}_mc'.*{message}", run, {"fail_at": 0.6})
    # Another run begins anew.
    if "initialise" not in message:
        assert np.isfinite(run({"fail_at": 9.0})["angle"]).all()


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(
    ("behaviour", "message"),
    [
        (5, r"does not find its state after an event at t = 0\.\d+ s"),
        (6, r"one more event at t = 0\.\d+ s, without end"),
    ],
)
def test_events_without_end_end_a_run(rods, version, behaviour, message):
    run = al.foreign.FmuSimulation(here(rods(version, wall=True), settings={"behaviour": behaviour}), GRID)
    refused(al.SimulationError, f"FMU 'rod{version}_wall_mc'.*{message}", run, {"fail_at": 0.1})


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
