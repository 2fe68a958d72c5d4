"""The file of an FMU: unpacked, and what its description says; which variables may be set and read."""

import shutil
import tempfile
import weakref
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol
from xml.etree import ElementTree

import numpy as np

from aleator._core.border import meant, shown
from aleator._core.errors import MissingExtraError, ProblemError

# As much of another library's message as ours repeats.
_LONGEST = 160
MODEL_EXCHANGE, CO_SIMULATION = "model exchange", "co-simulation"
# Names in FMI 2 and 3.
REAL = ("Real", "Float64")
_WHOLE = ("Integer", "Enumeration", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64")
# As many names are listed in a message.
_LISTED = 6


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
    offered = {offer: interface for offer, interface in offered.items() if interface is not None}
    if not offered:
        raise ProblemError(
            f"FMU '{name}': expected {MODEL_EXCHANGE} or {CO_SIMULATION}; it offers scheduled execution alone."
        )
    if kind is not None and kind not in list(offered):
        hint = meant(kind, offered) if isinstance(kind, str) else ""
        raise ProblemError(f"FMU '{name}': expected as its kind one of {list(offered)}; received {shown(kind)}.{hint}")
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


class Variable(Protocol):
    """What is used of a variable of FMPy, which declares no types. Variables are told apart by identity."""

    name: str
    type: str
    causality: str
    variability: str
    initial: str | None
    valueReference: int  # noqa: N815
    shape: Sequence[int] | None
    nominal: str | float | None
    unit: str | None
    declaredType: Any  # noqa: N815

    def __hash__(self) -> int: ...


class Variables:
    """The variables of the FMU called `name`, by their names."""

    def __init__(self, name: str, description: Any):
        self._who = f"FMU '{name}'"
        self.all: dict[str, Variable] = {variable.name: variable for variable in description.modelVariables}
        rates = [derivative.variable for derivative in description.derivatives]
        self.rates: list[Variable] = rates
        self.states: list[Variable] = [rate.derivative for rate in rates]
        self.outputs = self._names("output")

    def refuse_odd_states(self) -> None:
        """Raise `ProblemError` unless each state is one real number with a rate."""
        odd = [
            rate.name
            for rate, state in zip(self.rates, self.states, strict=True)
            if state is None or not _is_number(state)
        ]
        if odd:
            raise ProblemError(
                f"{self._who}: expected states of one real number each; '{odd[0]}' is the rate of none. Use it for "
                "co-simulation, if it offers that."
            )

    def parameters(self) -> list[str]:
        """The real parameters, the names for which a number may be uncertain first of all."""
        return self._names("parameter")

    def inputs(self) -> list[str]:
        """The real inputs."""
        return self._names("input")

    def _names(self, causality: str) -> list[str]:
        return [name for name, variable in self.all.items() if variable.causality == causality and _is_number(variable)]

    def settable(self, names: Iterable[Any]) -> list[Variable]:
        """The variables of these names. Raises `ProblemError` for one that is no real number set before the start."""
        return [self._real(self._settable(name), name) for name in names]

    def readable(self, names: Any) -> list[Variable]:
        """The variables of these names, by default all outputs. Raises `ProblemError` for one that is no real one."""
        names = self.outputs if names is None else names
        if isinstance(names, str | bytes) or not isinstance(names, Sequence) or not names:
            raise ProblemError(
                f"{self._who}: expected a list of variables to read, such as {self.outputs[:3] or ['x']}; "
                f"received {shown(names)}."
            )
        if len(set(map(str, names))) < len(names):
            raise ProblemError(f"{self._who}: expected each variable to read once; received {shown(names)}.")
        return [self._real(self._known(name, self.outputs), name) for name in names]

    def of_inputs(self, names: Iterable[Any]) -> list[Variable]:
        """The inputs of these names. Raises `ProblemError` for one that is none."""
        found = []
        for name in names:
            variable = self._known(name, self.inputs())
            if variable.causality != "input":
                raise ProblemError(
                    f"{self._who}: expected an input, {_listed(self.inputs())}; received '{name}', whose causality is "
                    f"'{variable.causality}'."
                )
            found.append(self._real(variable, name))
        return found

    def setting(self, name: Any, value: Any) -> tuple[Variable, Any]:
        """A variable of any type and its value, checked, for every run."""
        variable = self._settable(name)
        if variable.shape:
            raise ProblemError(f"{self._who}: expected a setting of one value; '{name}' has shape {variable.shape}.")
        kind, fits = _kind_of(variable.type)
        if not fits(value):
            raise ProblemError(f"{self._who}: expected {kind} for '{name}'; received {shown(value)}.")
        return variable, value

    def _known(self, name: Any, near: Sequence[str]) -> Variable:
        if not isinstance(name, str):
            raise ProblemError(f"{self._who}: expected names of variables; received {shown(name)}.")
        if name not in self.all:
            hint = meant(name, list(self.all)) or f" Expected one like {_listed(near)}."
            raise ProblemError(f"{self._who} has no variable '{name}'.{hint}")
        return self.all[name]

    def _settable(self, name: Any) -> Variable:
        variable = self._known(name, self.parameters())
        if variable.causality == "input" or (variable.variability != "constant" and variable.initial == "exact"):
            return variable
        if variable.causality == "structuralParameter":
            return variable
        why = {
            "calculatedParameter": "which the FMU computes from other parameters",
            "independent": "which is the time",
        }.get(variable.causality)
        why = why or ("which is constant" if variable.variability == "constant" else "which the FMU computes")
        raise ProblemError(
            f"{self._who}: expected a parameter, an input or an initial value, such as {_listed(self.parameters())}; "
            f"received '{name}', {why} (causality '{variable.causality}', variability '{variable.variability}')."
        )

    def _real(self, variable: Variable, name: str) -> Variable:
        if variable.type not in REAL:
            raise ProblemError(
                f"{self._who}: expected a real variable; received '{name}' of type {variable.type}. Give values of "
                "other types once for all in Fmu(settings={...})."
            )
        if variable.shape:
            raise ProblemError(f"{self._who}: expected variables of one number; '{name}' has shape {variable.shape}.")
        return variable


def _is_number(variable: Variable) -> bool:
    return variable.type in REAL and not variable.shape


def _kind_of(kind: str) -> tuple[str, Any]:
    """What a value of a type is called, and whether a value is one."""
    if kind in _WHOLE:
        return "a whole number", lambda value: isinstance(value, int) and not isinstance(value, bool)
    if kind == "Boolean":
        return "True or False", lambda value: isinstance(value, bool)
    if kind == "String":
        return "a text", lambda value: isinstance(value, str)
    return "a number", lambda value: isinstance(value, int | float) and not isinstance(value, bool)


def _listed(names: Sequence[str]) -> str:
    more = ", …" if len(names) > _LISTED else ""
    return (", ".join(f"'{name}'" for name in names[:_LISTED]) + more) or "none"


def nominals_of(variables: Iterable[Variable]) -> np.ndarray:
    """The usual sizes that variables declare; 1 for others."""
    return np.array([abs(float(variable.nominal or 1.0)) or 1.0 for variable in variables])


def units_of(variables: Iterable[Variable]) -> Mapping[str, str]:
    """The units that variables declare, by name."""
    declared = {variable.name: variable.unit or getattr(variable.declaredType, "unit", None) for variable in variables}
    return {name: unit.replace(".", " ") for name, unit in declared.items() if unit}


def with_numbers(names: Iterable[str], values: Iterable[float]) -> str:
    """Values of variables as the end of a sentence; empty if there are none."""
    said = ", ".join(f"{name}={value:.6g}" for name, value in zip(names, values, strict=True))
    return f", with {said}" if said else ""


class Described:
    """What the description of an FMU says: of the FMU `name`, unpacked in a `folder`, as it is to be run.

    Raises `ProblemError` for a kind that it does not offer, and for settings that it does not have.
    """

    def __init__(
        self, name: str, folder: Path, kind: str | None, settings: Mapping[str, Any] | None, *, description: Any
    ):
        self.name, self.folder, self.description = name, folder, description
        self.kind = kind_of(name, description, kind)
        self.variables = Variables(name, description)
        if self.is_exchange:
            self.variables.refuse_odd_states()
        self.settings = self._settings(settings)
        self.offers_slopes = offers_slopes(folder, self.kind)
        self.indicators = int(description.numberOfEventIndicators)

    @property
    def is_exchange(self) -> bool:
        """Whether its states are integrated here."""
        return self.kind == MODEL_EXCHANGE

    @property
    def states(self) -> list[str]:
        """Its continuous states, in its own order; none of co-simulation, which keeps them to itself."""
        return [variable.name for variable in self.variables.states] if self.is_exchange else []

    def _settings(self, given: Any) -> dict[Variable, Any]:
        if not isinstance(given, Mapping | None):
            raise ProblemError(
                f"FMU '{self.name}': expected settings as values by name, such as {{'stages': 3}}; "
                f"received {shown(given)}."
            )
        # Variables of FMPy are told apart by identity, so that they may be keys.
        return dict(self.variables.setting(name, value) for name, value in (given or {}).items())
