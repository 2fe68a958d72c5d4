"""Formulas of SymPy as a system without time."""

from collections.abc import Mapping
from typing import Any, NamedTuple, final

import equinox as eqx
from jaxtyping import Array
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator._core.leaves import transparent
from aleator.dynamics import AlgebraicSystem
from aleator.foreign._sympy_program import Program, written
from aleator.foreign._sympy_symbols import expressions_by_name, found_in, named, numbers_for, symbols_given, units_for


class _Formulas(NamedTuple):
    """Formulas without their numbers: the structure, which determines what is compiled."""

    names: tuple[str, ...]
    outputs: Program
    units: tuple[tuple[str, str], ...]


@final
@transparent("numbers")
class SymPyFormulas(AlgebraicSystem):
    """A system without time from formulas of SymPy; made by `al.foreign.from_sympy_formulas`."""

    numbers: dict[str, Any]
    formulas: _Formulas = eqx.field(static=True)

    @property
    def units(self) -> Mapping[str, str]:  # type: ignore[override]
        """The units of outputs, as far as they are given."""
        return dict(self.formulas.units)

    @override
    def outputs(self) -> dict[str, Array]:
        return dict(zip(self.formulas.names, self.formulas.outputs(self.numbers), strict=True))


def from_sympy_formulas(
    outputs: Mapping[str, Any], numbers: Mapping[Any, Any], *, units: Mapping[str, str] | None = None
) -> SymPyFormulas:
    """A system without time, an `al.AlgebraicSystem`, from SymPy expressions.

        F, L, E, I = sympy.symbols("F L E I")
        beam = al.foreign.from_sympy_formulas({"sag": F * L**3 / (3 * E * I)}, {F: al.Normal(1e3, 50.0), L: 1.0, ...})

    - `outputs`: expressions by name;
    - `numbers`: a number, distribution or decision for each symbol in them; each has the symbol's name;
    - `units`: the units of outputs by name, for reports.

    Raises `ProblemError` for symbols without a number, for numbers that are not used, for equations (`Eq`), and for
    functions that JAX lacks; `MissingExtraError` without SymPy.
    """
    who = "from_sympy_formulas"
    formulas = expressions_by_name(f"{who}: outputs", outputs)
    given = symbols_given(f"{who}: numbers", numbers)
    found = found_in(who, formulas.values())
    if found.functions or found.derivatives:
        raise ProblemError(
            f"{who}: expected formulas without time; received {(*found.derivatives, *found.functions)[0]}. Use "
            "al.foreign.from_sympy for a system that moves."
        )
    meanings = named(who, found.symbols)
    return SymPyFormulas(
        numbers_for(who, found.symbols, given),
        _Formulas(tuple(formulas), written(who, list(formulas.values()), meanings), units_for(who, units, formulas)),
    )
