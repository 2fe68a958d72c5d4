"""What the description of an FMU says: how it may be run, and which of its variables may be set and read."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, final

import numpy as np
from jaxtyping import Float

from aleator._core.border import meant, refusal, shown
from aleator._core.errors import MissingExtraError, ProblemError

# What users call the interfaces, without signs between words, and FMI does. The first one offered is the default.
_KINDS = {
    "model exchange": ("ModelExchange", "modelexchange", "me"),
    "co-simulation": ("CoSimulation", "cosimulation", "cs"),
}
_REAL = ("Real", "Float64")  # in FMI 2 and 3
# What a value of other types is, in words.
_VALUES: dict[str, tuple[str, type | tuple[type, ...]]] = {
    "Boolean": ("True or False", bool),
    "String": ("a text", str),
    "Real": ("a number", (int, float)),
    "Float32": ("a number", (int, float)),
    "Float64": ("a number", (int, float)),
}
# As many names are listed in a message, and characters of another library's message repeated.
_LISTED, _LONGEST = 6, 160


def unpacked(path: Path, folder: Path) -> Any:
    """The model description of an FMU, which is unpacked into a folder.

    Raises `ProblemError` for a file that is no FMU of FMI 2 or 3 for this machine; `MissingExtraError` without FMPy.
    """
    try:
        import fmpy
    except ImportError as error:
        raise MissingExtraError("Fmu needs the library FMPy: install it with `pip install 'aleator[fmu]'`.") from error
    try:
        fmpy.extract(str(path), str(folder))
        description: Any = fmpy.read_model_description(str(folder))
        platforms = fmpy.supported_platforms(str(folder))
    except Exception as error:
        said = " ".join(str(getattr(error, "problems", [error])[0]).split())[:_LONGEST].rstrip(".")
        raise ProblemError(f"Fmu: '{path}' cannot be read as an FMU ({said}).") from error
    if description.fmiVersion.startswith("1"):
        raise ProblemError(f"FMU '{path.stem}': expected FMI 2 or 3; received FMI {description.fmiVersion}.")
    if fmpy.platform not in platforms:
        raise ProblemError(
            f"FMU '{path.stem}': expected a binary for this machine, {fmpy.platform}; it has "
            f"{', '.join(platforms) or 'none'}: export it for this one, or compile sources by `fmpy compile`."
        )
    return description


def kind_of(name: str, description: Any, kind: Any) -> str:
    """How an FMU is run: as it is asked for, or the first of model exchange and co-simulation that it offers."""
    offered = {
        words: spellings
        for words, spellings in _KINDS.items()
        if getattr(description, spellings[0][0].lower() + spellings[0][1:]) is not None
    }
    if kind is None and offered:
        return next(iter(offered))
    plain = re.sub(r"[\s_-]", "", kind).lower() if isinstance(kind, str) else ""
    for words, spellings in offered.items():
        if plain in spellings[1:]:
            return words
    hint = meant(kind, offered) if isinstance(kind, str) else ""
    raise ProblemError(f"FMU '{name}': expected as its kind one of {list(offered)}; received {shown(kind)}.{hint}")


def interface_of(kind: str) -> str:
    """What FMI and FMPy call a kind."""
    return _KINDS[kind][0]


@final
class Variables:
    """The variables of the FMU called `name`, by their names."""

    def __init__(self, name: str, description: Any):
        self._who = f"FMU '{name}'"
        self.all: dict[str, Any] = {variable.name: variable for variable in description.modelVariables}
        self._rates = [derivative.variable for derivative in description.derivatives]

    def states(self) -> list[str]:
        """The continuous states. Raises `ProblemError` unless each is one real number with a rate."""
        for rate in self._rates:
            if rate.derivative is None or not _is_number(rate.derivative):
                raise ProblemError(
                    f"{self._who}: expected states of one real number each; '{rate.name}' is the rate of none. Use it "
                    "for co-simulation, if it offers that."
                )
        return [rate.derivative.name for rate in self._rates]

    def of(self, causality: str) -> list[str]:
        """The real variables of a causality."""
        return [name for name, variable in self.all.items() if variable.causality == causality and _is_number(variable)]

    def settable(self, names: Iterable[Any]) -> list[str]:
        """Names, each checked to be of a real variable that may be set before the start, or `ProblemError`."""
        return self._checked(names, "a parameter, an input or an initial value", "parameter", _is_settable)

    def inputs(self, names: Iterable[Any]) -> list[str]:
        """Names, each checked to be of a real input, or `ProblemError`."""
        return self._checked(names, "an input", "input", lambda variable: variable.causality == "input")

    def readable(self, names: Any) -> list[str]:
        """Names, by default of all outputs, each checked to be of a real variable, or `ProblemError`."""
        names = self.of("output") if names is None else names
        if isinstance(names, str | bytes) or not isinstance(names, Sequence) or not names:
            raise refusal(self._who, "a list of variables to read", names)
        if len(set(map(str, names))) < len(names):
            raise refusal(self._who, "each variable to read once", names)
        return self._checked(names, "a variable", "output", lambda _: True)

    def refuse_settings(self, settings: Mapping[str, Any]) -> None:
        """Raise `ProblemError` for settings that are no values of variables of any type."""
        self._checked(
            settings, "a parameter, an input or an initial value", "parameter", _is_settable, of_any_type=True
        )
        for name, value in settings.items():
            words, kinds = _VALUES.get(self.all[name].type, ("a whole number", int))
            if not isinstance(value, kinds) or (isinstance(value, bool) and kinds is not bool):
                raise refusal(f"{self._who}: '{name}'", words, value)

    def nominals(self, names: Iterable[str]) -> Float[np.ndarray, " n"]:
        """The usual sizes that variables declare; 1 for others."""
        return np.array([abs(float(self.all[name].nominal or 1.0)) or 1.0 for name in names])

    def units(self, names: Iterable[str]) -> Mapping[str, str]:
        """The units that variables declare, by name."""
        declared = {name: self.all[name].unit or getattr(self.all[name].declaredType, "unit", None) for name in names}
        return {name: unit.replace(".", " ") for name, unit in declared.items() if unit}

    def _checked(
        self,
        names: Iterable[Any],
        expected: str,
        causality: str,
        fits: Callable[[Any], bool],
        *,
        of_any_type: bool = False,
    ) -> list[str]:
        names, near = list(names), self.of(causality)
        listed = (", ".join(f"'{name}'" for name in near[:_LISTED]) or "none") + ", …" * (len(near) > _LISTED)
        for name in names:
            if name not in self.all:
                hint = isinstance(name, str) and meant(name, list(self.all))
                raise ProblemError(
                    f"{self._who} has no variable {shown(name)}.{hint or f' Expected one like {listed}.'}"
                )
            variable = self.all[name]
            if variable.shape or not (of_any_type or _is_number(variable)):
                raise ProblemError(
                    f"{self._who}: expected a real variable of one number; received '{name}' of type {variable.type}"
                    f"{f' and shape {variable.shape}' if variable.shape else ''}. Other types are set for all runs by "
                    "Fmu(settings={...})."
                )
            if not fits(variable):
                why = "which is constant" if variable.variability == "constant" else "which the FMU computes"
                why = why if variable.causality not in ("parameter", "input") else "which is none"
                raise ProblemError(
                    f"{self._who}: expected {expected}, such as {listed}; received '{name}', {why} (causality "
                    f"'{variable.causality}', variability '{variable.variability}')."
                )
        return names


def _is_number(variable: Any) -> bool:
    return variable.type in _REAL and not variable.shape


def _is_settable(variable: Any) -> bool:
    is_first = variable.variability != "constant" and variable.initial == "exact"
    return is_first or variable.causality in ("input", "structuralParameter")


def with_numbers(names: Iterable[str], values: Iterable[float]) -> str:
    """Values of variables as the end of a sentence; empty if there are none."""
    said = ", ".join(f"{name}={value:.6g}" for name, value in zip(names, values, strict=True))
    return f", with {said}" if said else ""
