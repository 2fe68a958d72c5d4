"""A rod that swings, compiled as an FMU of any kind."""

import inspect
import re
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Any

import pytest

import aleator as al

SOURCE = Path(__file__).with_name("rod.c")

# name, causality, variability, initial, start, and further attributes; the place in the list is the value reference.
REALS: list[tuple[str, str, str, str | None, float | None, str]] = [
    ("time", "independent", "continuous", None, None, ""),
    ("angle", "output", "continuous", "exact", 1.0, 'unit="rad"'),
    ("rate", "output", "continuous", "exact", 0.0, 'unit="rad/s"'),
    ("der(angle)", "local", "continuous", None, None, 'derivative="{angle}"'),
    ("der(rate)", "local", "continuous", None, None, 'derivative="{rate}"'),
    ("rod.mass", "parameter", "fixed", "exact", 1.0, 'unit="kg"'),
    ("rod.length", "parameter", "fixed", "exact", 1.0, 'unit="m"'),
    ("damping", "parameter", "tunable", "exact", 0.1, 'unit="N.m.s/rad"'),
    ("gravity", "parameter", "fixed", "exact", 9.81, 'unit="m/s2"'),
    ("torque", "input", "continuous", None, 0.0, 'unit="N.m"'),
    ("energy", "output", "continuous", "calculated", None, 'unit="J"'),
    ("rod.inertia", "calculatedParameter", "fixed", "calculated", None, ""),
    ("fail_at", "parameter", "fixed", "exact", 1e9, 'unit="s"'),
    ("wall", "parameter", "fixed", "exact", -0.5, 'unit="rad"'),
]
UNITS = sorted({found for *_, more in REALS for found in re.findall(r'unit="([^"]+)"', more)})


def description(version: int, *, wall: bool) -> str:
    """The modelDescription.xml of the rod."""
    units = "".join(f'<Unit name="{one}"/>' for one in UNITS)
    wants = 'needsCompletedIntegratorStep="true"' if version == 3 else ""
    offered = (
        f'<ModelExchange modelIdentifier="rod" {wants}/>'
        '<CoSimulation modelIdentifier="rod" canHandleVariableCommunicationStepSize="true"/>'
    )
    variables = "".join(_real(version, place, *one) for place, one in enumerate(REALS))
    if version == 2:
        variables += (
            '<ScalarVariable name="behaviour" valueReference="100" causality="parameter" variability="fixed" '
            'initial="exact"><Integer start="0"/></ScalarVariable>'
            '<ScalarVariable name="started" valueReference="101" causality="parameter" variability="fixed" '
            'initial="exact"><Boolean start="true"/></ScalarVariable>'
        )
        structure = (
            "<Outputs>" + "".join(f'<Unknown index="{index}"/>' for index in (2, 3, 11)) + "</Outputs>"
            '<Derivatives><Unknown index="4"/><Unknown index="5"/></Derivatives>'
            "<InitialUnknowns>"
            + "".join(f'<Unknown index="{index}"/>' for index in (4, 5, 11, 12))
            + "</InitialUnknowns>"
        )
        indicators = f'numberOfEventIndicators="{int(wall)}"'
        head = f'fmiVersion="2.0" modelName="rod" guid="rod" {indicators}'
    else:
        variables += (
            '<Float64 name="distance" valueReference="99" causality="local" variability="continuous" '
            'initial="calculated"/>'
            * wall
            + '<Int32 name="behaviour" valueReference="100" causality="parameter" variability="fixed" start="0"/>'
            '<Boolean name="started" valueReference="101" causality="parameter" variability="fixed" start="true"/>'
        )
        structure = (
            "".join(f'<Output valueReference="{one}"/>' for one in (1, 2, 10))
            + "".join(f'<ContinuousStateDerivative valueReference="{one}"/>' for one in (3, 4))
            + "".join(f'<InitialUnknown valueReference="{one}"/>' for one in (3, 4, 10, 11))
            + '<EventIndicator valueReference="99"/>' * wall
        )
        head = 'fmiVersion="3.0" modelName="rod" instantiationToken="rod"'
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription {head}>{offered}'
        f"<UnitDefinitions>{units}</UnitDefinitions><ModelVariables>{variables}</ModelVariables>"
        f"<ModelStructure>{structure}</ModelStructure></fmiModelDescription>"
    )


def _real(version, place, name, causality, variability, initial, start, more):
    head = f'name="{name}" valueReference="{place}" causality="{causality}" variability="{variability}"'
    head += f' initial="{initial}"' if initial else ""
    value = "" if start is None else f' start="{start!r}"'
    more = more.format(angle=4 - version, rate=5 - version)
    if version == 2:
        return f"<ScalarVariable {head}><Real{value} {more}/></ScalarVariable>"
    return f"<Float64 {head}{value} {more}/>"


def _stubs(version: int, written: str) -> str:
    """Functions that FMPy looks for and the rod does not need: they fail, should they be called."""
    from fmpy import fmi2, fmi3

    kinds = {2: (fmi2.FMU2Model, fmi2.FMU2Slave), 3: (fmi3.FMU3Model, fmi3.FMU3Slave)}[version]
    names = {name for kind in kinds for name, _ in inspect.getmembers(kind) if name.startswith(f"fmi{version}")}
    missing = sorted(name for name in names if not re.search(rf"{name}\b|NAME\({name[4:]}\)", written))
    return "".join(f"int {name}(void) {{ return 3; }}\n" for name in missing)


class Rods:
    """FMUs of the rod, each compiled once: `rods(3, wall=True)` is the path of one."""

    def __init__(self, folder: Path):
        self.folder = folder

    def __call__(self, version: int = 3, *, wall: bool = False) -> Path:
        path = self.folder / f"rod{version}{'_wall' * wall}_mc.fmu"
        if not path.exists():
            with zipfile.ZipFile(path, "w") as archive:
                archive.writestr("modelDescription.xml", description(version, wall=wall))
                archive.write(self.library(version, wall), f"binaries/{platform(version)}")
        return path

    def library(self, version: int, wall: bool) -> Path:
        import fmpy

        path = self.folder / f"rod{version}{wall}{fmpy.sharedLibraryExtension}"
        stubs = self.folder / f"stubs{version}.c"
        stubs.write_text(_stubs(version, SOURCE.read_text()))
        headers = Path(fmpy.__file__).with_name("c-code")
        options = [f"-DFMI={version}", *(["-DWALL"] if wall else []), "-O2", "-shared", "-fPIC", f"-I{headers}"]
        command = ["gcc", *options, str(SOURCE), str(stubs), "-o", str(path), "-lm"]
        built = subprocess.run(command, capture_output=True, text=True)
        assert built.returncode == 0, built.stderr
        return path


def platform(version: int) -> str:
    """The place of a library inside an FMU for this machine."""
    import fmpy

    folder = fmpy.platform if version == 2 else fmpy.platform_tuple
    return f"{folder}/rod{fmpy.sharedLibraryExtension}"


def here(path: Path, **given: Any) -> al.foreign.Fmu:
    """An FMU whose code runs in this process, which is sooner ready."""
    return al.foreign.Fmu(path, own_process=False, **given)


@pytest.fixture(scope="session")
def rods(tmp_path_factory):
    """FMUs of the swinging rod. Skips without the compiler or FMPy."""
    pytest.importorskip("fmpy", reason="FMPy is not installed")
    if shutil.which("gcc") is None:
        pytest.skip("gcc, which compiles the FMU of these tests, is not installed")
    return Rods(tmp_path_factory.mktemp("rods"))
