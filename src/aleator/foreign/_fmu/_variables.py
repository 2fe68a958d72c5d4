"""Variables of an FMU by name: which may be set before it starts, which are read; refusals name the nearest one."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from aleator._core.border import meant, shown
from aleator._core.errors import ProblemError

# Names in FMI 2 and 3.
REAL = ("Real", "Float64")
_WHOLE = ("Integer", "Enumeration", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64")
# As many names are listed in a message.
_LISTED = 6


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
        self.all: dict[str, Variable] = {one.name: one for one in description.modelVariables}
        rates = [one.variable for one in description.derivatives]
        self.rates: list[Variable] = rates
        self.states: list[Variable] = [one.derivative for one in rates]
        self.outputs = [name for name, one in self.all.items() if one.causality == "output" and _is_number(one)]

    def refuse_odd_states(self) -> None:
        """Raise `ProblemError` unless each state is one real number with a rate."""
        odd = [
            rate.name for rate, one in zip(self.rates, self.states, strict=True) if one is None or not _is_number(one)
        ]
        if odd:
            raise ProblemError(
                f"{self._who}: expected states of one real number each; '{odd[0]}' is the rate of none. Use it for "
                "co-simulation, if it offers that."
            )

    def parameters(self) -> list[str]:
        """The real parameters, the names for which a number may be uncertain first of all."""
        return [name for name, one in self.all.items() if one.causality == "parameter" and _is_number(one)]

    def inputs(self) -> list[str]:
        """The real inputs."""
        return [name for name, one in self.all.items() if one.causality == "input" and _is_number(one)]

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
            one = self._known(name, self.inputs())
            if one.causality != "input":
                raise ProblemError(
                    f"{self._who}: expected an input, {_listed(self.inputs())}; received '{name}', whose causality is "
                    f"'{one.causality}'."
                )
            found.append(self._real(one, name))
        return found

    def setting(self, name: Any, value: Any) -> tuple[Variable, Any]:
        """A variable of any type and its value, checked, for every run."""
        one = self._settable(name)
        if one.shape:
            raise ProblemError(f"{self._who}: expected a setting of one value; '{name}' has the shape {one.shape}.")
        kind, fits = _kind_of(one.type)
        if not fits(value):
            raise ProblemError(f"{self._who}: expected {kind} for '{name}'; received {shown(value)}.")
        return one, value

    def _known(self, name: Any, near: Sequence[str]) -> Variable:
        if not isinstance(name, str):
            raise ProblemError(f"{self._who}: expected names of variables; received {shown(name)}.")
        if name not in self.all:
            hint = meant(name, list(self.all)) or f" Expected one like {_listed(near)}."
            raise ProblemError(f"{self._who} has no variable '{name}'.{hint}")
        return self.all[name]

    def _settable(self, name: Any) -> Variable:
        one = self._known(name, self.parameters())
        if one.causality == "input" or (one.variability != "constant" and one.initial == "exact"):
            return one
        if one.causality == "structuralParameter":
            return one
        why = {
            "calculatedParameter": "which the FMU computes from other parameters",
            "independent": "which is the time",
        }.get(one.causality, "which is constant" if one.variability == "constant" else "which the FMU computes")
        raise ProblemError(
            f"{self._who}: expected a parameter, an input or an initial value, such as {_listed(self.parameters())}; "
            f"received '{name}', {why} (causality '{one.causality}', variability '{one.variability}')."
        )

    def _real(self, one: Variable, name: str) -> Variable:
        if one.type not in REAL:
            raise ProblemError(
                f"{self._who}: expected a real variable; received '{name}' of type {one.type}. Give values of other "
                "types once for all in Fmu(settings={...})."
            )
        if one.shape:
            raise ProblemError(f"{self._who}: expected variables of one number; '{name}' has the shape {one.shape}.")
        return one


def _is_number(one: Variable) -> bool:
    return one.type in REAL and not one.shape


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
    return (", ".join(f"'{one}'" for one in names[:_LISTED]) + more) or "none"


def nominals_of(variables: Iterable[Variable]) -> np.ndarray:
    """The usual sizes that variables declare; 1 for others."""
    return np.array([abs(float(one.nominal or 1.0)) or 1.0 for one in variables])


def units_of(variables: Iterable[Variable]) -> Mapping[str, str]:
    """The units that variables declare, by name."""
    declared = {one.name: one.unit or getattr(one.declaredType, "unit", None) for one in variables}
    return {name: unit.replace(".", " ") for name, unit in declared.items() if unit}


def with_numbers(names: Iterable[str], values: Iterable[float]) -> str:
    """Values of variables as the end of a sentence; empty if there are none."""
    said = ", ".join(f"{name}={value:.6g}" for name, value in zip(names, values, strict=True))
    return f", with {said}" if said else ""
