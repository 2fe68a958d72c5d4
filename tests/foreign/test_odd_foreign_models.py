"""What foreign models say that is nearly right: it is refused in a sentence, never taken for something else."""

import builtins
import sys
import zipfile

import numpy as np
import pytest

import aleator as al
from aleator.foreign import _openmdao
from zoo import bar_problem

UNCERTAIN = {"m": al.Uniform(1.0, half_width=0.1)}
EXPANSION = al.Expansion(order=1)


def expanded(function, **options):
    return al.expand(al.foreign.BlackBox(function, **options), UNCERTAIN, EXPANSION)


def leave(_):
    sys.exit(3)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda at: {1: 2.0, "b": 3.0}, r"must return dicts by texts; received names of the types int, str"),
        (lambda at: 10**400, r"a whole number beyond 1e308"),
        (lambda at: np.ma.masked_array([1.0, 2.0], mask=[0, 1]), r"returned masked numbers"),
        (leave, r"'leave' failed at sample 1 .*: it ended itself by sys.exit\(3\)"),
    ],
    ids=["names of two kinds", "huge", "masked", "ends itself"],
)
def test_a_black_box_that_returns_what_is_no_number_fails_with_its_sample(function, message):
    with pytest.raises(al.SimulationError, match=message) as caught:
        expanded(function)
    assert "sample 1 (m=" in str(caught.value)


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ('print(\'{"a": 1, "a": 2}\')', "expected each output once; received 'a' twice"),
        ("print('[' * 100000)", "expected JSON in its standard output; received"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "it ended by the signal SIGSEGV; its stderr is"),
        ("import os; os.mkdir('out.json')", "it ended without writing out.json"),
    ],
    ids=["an output twice", "depth", "a crash", "a folder"],
)
def test_a_command_that_writes_nonsense_fails(code, message, tmp_path):
    (tmp_path / "odd.py").write_text(code)
    output = {"output_file": "out.json"} if "mkdir" in code else {}
    command = al.foreign.Command([sys.executable, str(tmp_path / "odd.py"), "{m}"], **output)
    with pytest.raises(al.SimulationError, match=message):
        expanded(command)


def test_an_argument_that_no_system_takes_is_refused():
    with pytest.raises(al.ProblemError, match=r"cannot be run .*embedded null byte"):
        expanded(al.foreign.Command([sys.executable, "a\0b", "{m}"]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda line: f"{line},1,5", "expected 3 entries in each row, .* received 4 in row 1. Numbers have decimal"),
        (lambda line: f"{line},1_0", "expected numbers in the column 'y'"),
    ],
    ids=["decimal commas", "digits apart"],
)
def test_a_table_whose_numbers_have_commas_is_refused_not_rounded(change, message, tmp_path):
    asked, path = al.foreign.ask(UNCERTAIN, EXPANSION), tmp_path / "answers.csv"
    asked.write_csv(path)
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([f"{header},y", *map(change, rows)]))
    with pytest.raises(al.ProblemError, match=message):
        asked.tell(path)


@pytest.mark.parametrize("number", ["Integer(10)**400"])
def test_numbers_of_sympy_that_no_machine_holds_are_refused(number):
    sympy = pytest.importorskip("sympy")
    x = sympy.Symbol("x")
    with pytest.raises(al.ProblemError, match="from_sympy: expected numbers below 1e308; received"):
        al.foreign.from_sympy({x: eval(f"sympy.{number}", {"sympy": sympy}) * x}, {})


def test_fractions_of_sympy_are_the_nearest_numbers():
    sympy = pytest.importorskip("sympy")
    x = sympy.Symbol("x")
    system = al.foreign.from_sympy({x: sympy.Rational(10**40 + 1, 3 * 10**40) + 0 * x}, {}, start={x: 0.0})
    assert float(al.simulate(system, al.Grid(3.0, 1))["x"][-1]) == pytest.approx(1.0, abs=1e-15)


INERTIA = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
LINK = f'<link name="{{}}"><inertial><mass value="1"/>{INERTIA}</inertial></link>'
ARM = LINK.format("base") + LINK.format("arm")
HINGE = '<joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/>{}</joint>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ARM + HINGE.format('<origin rpyy="1 0 0"/>'), "joint 'hinge': <origin>: expected some of .*; received 'rpyy'"),
        (ARM.replace("<mass value", "<mass walue") + HINGE.format(""), "<mass>: expected some of .*'walue'"),
        (ARM.replace("inertial", "Inertial") + HINGE.format(""), "received <Inertial>. Did you mean 'inertial'"),
        (ARM + HINGE.format('<limit lower="1" upper="-1"/>'), r"<limit>: expected a lower limit below the upper"),
        (ARM + HINGE.format('<limit effort="-1"/>'), r"<limit>: expected effort that is not negative; received -1"),
        (
            ARM.replace('mass value="1"', 'mass value="1_0"') + HINGE.format(""),
            "value as a finite number; received '1_",
        ),
    ],
)
def test_slips_of_the_pen_in_a_urdf_are_not_ignored(text, message, tmp_path):
    path = tmp_path / "slip.urdf"
    path.write_text(f'<robot name="slip">{text}</robot>')
    with pytest.raises(al.ProblemError, match=message):
        al.foreign.read_urdf(path)


def test_an_unknown_encoding_is_told(tmp_path):
    path = tmp_path / "odd.urdf"
    path.write_bytes(b'<?xml version="1.0" encoding="nope"?><robot name="r"/>')
    with pytest.raises(
        al.ProblemError, match=r"odd.urdf: expected a file that can be read; received: unknown encoding"
    ):
        al.foreign.read_urdf(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '<body name="a"><joint/><geom name="ball" size="1" pos="nan 0 0"/></body>',
            "geom 'ball': expected numbers as",
        ),
        ("", "expected a model with a body; received none"),
    ],
    ids=["NaN", "no body"],
)
def test_an_mjcf_without_numbers_or_bodies_is_refused(text, message, tmp_path):
    pytest.importorskip("mujoco")
    path = tmp_path / "odd.xml"
    path.write_text(f"<mujoco><worldbody>{text}</worldbody></mujoco>")
    with pytest.raises(al.ProblemError, match=message):
        al.foreign.read_mjcf(path)


@pytest.mark.parametrize(
    ("package", "extra", "call"),
    [
        ("fmpy", "fmu", lambda: al.foreign.Fmu("pendulum.fmu")),
        ("mujoco", "robots", lambda: al.foreign.read_mjcf("robot.xml")),
        ("sympy", "sympy", lambda: al.foreign.from_sympy({}, {})),
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
    (tmp_path / "robot.xml").write_text("<mujoco/>")
    with zipfile.ZipFile("pendulum.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", '<fmiModelDescription fmiVersion="2.0"/>')
    _openmdao._component.cache_clear()
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(al.MissingExtraError, match=rf"pip install 'aleator\[{extra}\]'"):
        call()
