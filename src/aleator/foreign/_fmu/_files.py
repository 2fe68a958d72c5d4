"""The file of an FMU: read, checked and unpacked."""

import shutil
import tempfile
import weakref
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from aleator._core.border import shown
from aleator._core.errors import MissingExtraError, ProblemError

# As much of another library's message as ours repeats.
_LONGEST = 160
MODEL_EXCHANGE, CO_SIMULATION = "model exchange", "co-simulation"


def load_fmpy(who: str) -> Any:
    """FMPy, imported late. Raises `MissingExtraError` if it is not installed."""
    try:
        import fmpy
        import fmpy.fmi1
        import fmpy.fmi2
        import fmpy.fmi3
        import fmpy.model_description
    except ImportError as error:
        raise MissingExtraError(
            f"{who} needs the library FMPy: install it with `pip install 'aleator[fmu]'`."
        ) from error
    return fmpy


def path_of(given: Any) -> Path:
    """The path of an existing zip file. Raises `ProblemError` for anything else."""
    if not isinstance(given, str | Path) or not str(given):
        raise ProblemError(f"Fmu: expected the path of an FMU, such as 'pendulum.fmu'; received {shown(given)}.")
    path = Path(given)
    if not path.is_file():
        raise ProblemError(f"Fmu: expected the path of an FMU; there is no file '{path}'.")
    if not zipfile.is_zipfile(path):
        raise ProblemError(f"Fmu: '{path.name}' is no FMU: expected a zip file with a modelDescription.xml in it.")
    return path


def folder_of(owner: object) -> Path:
    """An empty folder, which is deleted with its `owner`."""
    found = Path(tempfile.mkdtemp(prefix="aleator-fmu-"))
    weakref.finalize(owner, shutil.rmtree, found, ignore_errors=True)
    return found


def read_description(path: Path, folder: Path) -> Any:
    """The model description of an FMU, unpacked into a folder.

    Raises `ProblemError` if it is missing, invalid, or of FMI 1.
    """
    load_fmpy("Fmu")
    with zipfile.ZipFile(path) as archive:
        if "modelDescription.xml" not in archive.namelist():
            raise ProblemError(f"Fmu: '{path.name}' is no FMU: expected a modelDescription.xml in it; there is none.")
    _unpack(path, folder, include=lambda name: name.endswith("Description.xml"))
    return described(path.stem, folder)


def described(name: str, folder: Path, *, validate: bool = True) -> Any:
    """The model description in the folder of the FMU `name`. Raises `ProblemError` if it is invalid, or of FMI 1."""
    try:
        found = load_fmpy("Fmu").read_model_description(str(folder), validate=validate)
    except Exception as error:
        is_lacking = isinstance(error, AttributeError | TypeError | LookupError)
        reason = "it lacks what FMI requires, such as fmiVersion" if is_lacking else str(error)
        problems = getattr(error, "problems", None) or [reason]
        first = " ".join(str(problems[0]).split())[:_LONGEST].rstrip(".")
        raise ProblemError(f"FMU '{name}': its modelDescription.xml cannot be read: {first}.") from error
    if found.fmiVersion.startswith("1"):
        raise ProblemError(f"FMU '{name}': expected FMI 2 or 3; received FMI {found.fmiVersion}.")
    return found


def offers_slopes(folder: Path, kind: str) -> bool:
    """Whether an FMU says that it provides directional derivatives: FMPy reads what FMI 2 calls this alone."""
    root = ElementTree.parse(folder / "modelDescription.xml").getroot()
    interface = root.find("ModelExchange" if kind == MODEL_EXCHANGE else "CoSimulation")
    flags = () if interface is None else (interface.get(f"providesDirectionalDerivative{end}") for end in ("", "s"))
    return any(flag in ("true", "1") for flag in flags)


def kind_of(name: str, description: Any, kind: Any) -> str:
    """How an FMU is run: as it is asked for, or the first of model exchange and co-simulation that it offers."""
    offered = {MODEL_EXCHANGE: description.modelExchange, CO_SIMULATION: description.coSimulation}
    offered = {one: interface for one, interface in offered.items() if interface is not None}
    if not offered:
        raise ProblemError(
            f"FMU '{name}': expected {MODEL_EXCHANGE} or {CO_SIMULATION}; it offers scheduled execution alone."
        )
    if kind is not None and kind not in list(offered):
        raise ProblemError(f"FMU '{name}': expected as its kind one of {list(offered)}; received {shown(kind)}.")
    return next(iter(offered)) if kind is None else kind


def unpack_all(path: Path, folder: Path, description: Any, identifier: str) -> None:
    """Unpack an FMU into a folder. Raises `ProblemError` without a binary for this machine."""
    fmpy = load_fmpy("Fmu")
    platform = fmpy.platform if description.fmiVersion == "2.0" else fmpy.platform_tuple
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    library = f"{identifier}{fmpy.sharedLibraryExtension}"
    if f"binaries/{platform}/{library}" not in names:
        raise ProblemError(f"FMU '{path.stem}': expected {_lacking(path, names, platform, library)}.")
    _unpack(path, folder)


def _unpack(path: Path, folder: Path, include: Callable[[str], bool] | None = None) -> None:
    try:
        load_fmpy("Fmu").extract(str(path), str(folder), include)
    except Exception as error:
        raise ProblemError(f"FMU '{path.stem}' cannot be unpacked: {str(error)[:_LONGEST]}.") from error


def _lacking(path: Path, names: list[str], platform: str, library: str) -> str:
    """What an FMU lacks for this machine, what it has, and what to do."""
    there = sorted({name.split("/")[1] for name in names if name.startswith("binaries/") and name.count("/") > 1})
    if platform in there:
        return f"'{library}' among its binaries for {platform}; it has others: export it again"
    sources = any(name.startswith("sources/") and not name.endswith("/") for name in names)
    remedy = f"compile its sources by `fmpy compile {path.name}`" if sources else f"export it for {platform}"
    return f"a binary for this machine, {platform}; it has {', '.join(there) or 'none'}: {remedy}"
