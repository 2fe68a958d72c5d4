"""FMUs that cannot be used, wrong names and numbers, and runs that fail: one sentence each, with the FMU's name."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from rods import here

GRID = al.Grid(2.0, 4)
LONGEST = 400


def refused(error, message, call, *arguments, **named):
    with pytest.raises(error, match=message) as caught:
        call(*arguments, **named)
    assert len(str(caught.value)) < LONGEST


def test_an_fmu_says_what_it_offers(rods):
    assert str(here(rods(2), kind="model exchange")).splitlines() == [
        "FMU 'rod2_mc': FMI 2.0, model exchange; offers directional derivatives",
        "  parameters: rod.mass, rod.length, damping, gravity, fail_at, wall",
        "  inputs: torque",
        "  states: angle, rate",
        "  outputs: angle, rate, energy",
    ]
    assert str(al.foreign.FmuSimulation(here(rods(3)), GRID)).startswith("FMU 'rod3_mc', model exchange, from 0")


def test_files_that_are_no_fmu_are_refused(rods, tmp_path):
    text, empty = tmp_path / "text.fmu", tmp_path / "empty.fmu"
    text.write_text("a text")
    empty.write_bytes(b"PK\x05\x06" + 18 * b"\0")
    refused(al.ProblemError, "there is no file 'nobody.fmu'", al.foreign.Fmu, "nobody.fmu")
    refused(al.ProblemError, "'text.fmu' is no FMU: expected a zip file", al.foreign.Fmu, text)
    refused(al.ProblemError, "'empty.fmu' is no FMU: expected a modelDescription.xml", al.foreign.Fmu, empty)
    refused(al.ProblemError, "expected the path of an FMU, such as 'pendulum.fmu'; received 3.5", al.foreign.Fmu, 3.5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("<ModelVariables>", "<ModelVariable>"), "cannot be read: Opening and ending tag"),
        (lambda text: text.replace('"parameter"', '"param"'), "cannot be read: .* 'param' is not"),
        (lambda text: text.replace('fmiVersion="2.0"', 'fmiVersion="1.5"'), "Unsupported FMI version: 1.5"),
        (lambda text: text.replace('Identifier="rod"', 'Identifier="bar"'), r"expected 'bar.*' among its binaries"),
        (lambda text: "<fmiModelDescription/>", "cannot be read: it lacks what FMI requires, such as fmiVersion"),
    ],
    ids=["no XML", "no causality", "no version", "no library", "nothing in it"],
)
def test_descriptions_that_are_wrong_are_refused(rods, change, message):
    refused(al.ProblemError, f"FMU 'wrong': .*{message}", al.foreign.Fmu, rods.changed("wrong", change))


def test_an_fmu_for_another_platform_is_refused(rods):
    path = rods.changed("elsewhere", lambda text: text, at="binaries/riscv-plan9/rod.so")
    message = r"FMU 'elsewhere': expected a binary for this machine, \S+; it has riscv-plan9: export it for"
    refused(al.ProblemError, message, al.foreign.Fmu, path)


@pytest.mark.slow
def test_a_library_that_is_none_is_refused(rods):
    path = rods.changed("hollow", lambda text: text, content=b"nothing")
    refused(al.ProblemError, "FMU 'hollow': its library cannot be loaded", al.foreign.Fmu, path)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("dampin", r"has no variable 'dampin'. Did you mean 'damping'\?"),
        ("rod.inertia", "'rod.inertia', which the FMU computes from other parameters"),
        ("energy", "'energy', which the FMU computes .causality 'output'"),
        ("time", "'time', which is the time"),
        ("der(rate)", "which the FMU computes .causality 'local'"),
        ("behaviour", r"received 'behaviour' of type Int32. Give values of other types once for all in Fmu\(settings"),
    ],
)
def test_names_that_are_no_parameters_are_refused(rods, name, message):
    fmu = here(rods(3))
    refused(al.ProblemError, f"FMU 'rod3_mc'.*{message}", al.foreign.FmuSimulation(fmu, GRID), {name: 1.0})
    refused(al.ProblemError, f"FMU 'rod3_mc'.*{message}", al.foreign.FmuSystem, fmu, {name: 1.0})


def test_numbers_that_are_none_are_refused(rods):
    run = al.foreign.FmuSimulation(here(rods(3)), GRID)
    refused(al.ProblemError, "'damping': expected a finite number; received 'x'", run, {"damping": "x"})
    refused(al.ProblemError, "'damping': expected a finite number; received nan", run, {"damping": np.nan})
    refused(al.ProblemError, "expected numbers by the names of parameters", run, 3.0)
    refused(al.ProblemError, "Give it to al.expand", run, {"damping": al.Uniform(0.1, half_width=0.01)})
    refused(al.ProblemError, "received the shape .2,.", jax.jit(run), {"damping": jnp.ones(2)})


def test_outputs_inputs_and_settings_are_checked(rods):
    fmu, ramp, short = here(rods(3)), al.Tabulated([0.0, 2.0], [0.0, 1.0]), al.Tabulated([0.0, 1.0], [0.0, 1.0])

    def run(grid=GRID, **named):
        return al.foreign.FmuSimulation(fmu, grid, **named)

    for words, call in (
        (r"no variable 'angel'. Did you mean 'angle'\?", lambda: run(outputs=["angel"])),
        ("expected a list of variables to read, .* received 'angle'", lambda: run(outputs="angle")),
        ("expected each variable to read once", lambda: run(outputs=["angle", "angle"])),
        ("received 'damping', whose causality is 'parameter'", lambda: run(inputs={"damping": ramp})),
        ("expected a signal, .*; received 1.0", lambda: run(inputs={"torque": 1.0})),
        ("from 0 to 1 s; expected from 0 to 2 s", lambda: run(inputs={"torque": short})),
        ("given by a signal; leave it out", lambda: run(inputs={"torque": ramp})({"torque": 1.0})),
        ("a grid whose final time is known", lambda: run(al.Grid(al.Decision(1.0, 0.5, 2.0), 4))),
        ("expected one of|expected as its kind", lambda: here(rods(3), kind="both")),
        ("a whole number for 'behaviour'; received 1.5", lambda: here(rods(3), settings={"behaviour": 1.5})),
        ("True or False for 'started'; received 1", lambda: here(rods(3), settings={"started": 1})),
        ("no variable 'stages'", lambda: here(rods(3), settings={"stages": 3})),
    ):
        refused(al.ProblemError, words, call)


FAILURES = {
    "fails": (1, r"failed at t = \S+ s: the hinge is broken.*error., with fail_at=0.6"),
    "ends": (2, r"ended the simulation at t = \S+ s, with fail_at=0.6"),
    "no number": (3, r"not finite at t = 0\.6|output 'energy' is nan at t = 1 s, with fail_at=0.6"),
    "no start": (4, "failed to initialise: no position at rest"),
}


@pytest.mark.parametrize(("version", "kind"), [(2, "model exchange"), (3, "model exchange"), (3, "co-simulation")])
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
