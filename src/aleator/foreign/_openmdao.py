"""A problem of ours as a component of OpenMDAO: decisions in, objective and constraints out, with exact partials."""

import functools
import math
import re
from collections.abc import Collection, Iterable
from itertools import count
from typing import Any

import numpy as np

from aleator._core.border import one_of
from aleator._core.errors import ProblemError, optional
from aleator.design import Problem, is_at_points, is_worst_case, number_unit, units_of
from aleator.nlp import Evaluation
from aleator.statistics import measure
from aleator.transcription import transcribe
from aleator.uncertainty import refuse_choices

_OBJECTIVE = "objective"
_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺", "0123456789-+")
_ROOTS = {
    **{"meter": "m", "gram": "g", "second": "s", "ampere": "A", "kelvin": "degK", "mole": "mol", "candela": "cd"},
    "radian": "rad",
}

# Digits of the sizes of units in OpenMDAO's library, such as that of psi.
_DIGITS = 1e-8


def openmdao_component(problem: Problem, *, declared: bool = True) -> Any:
    """A problem as an `openmdao.api.ExplicitComponent`, for a larger model, or for OpenMDAO's drivers.

        model = openmdao.api.Problem()
        model.model.add_subsystem("design", al.foreign.openmdao_component(problem), promotes=["*"])
        model.driver = openmdao.api.ScipyOptimizeDriver(optimizer="SLSQP")

    Its inputs are the decisions, from their initial values; its outputs `objective`, and the values of each constraint,
    without its bounds: one for each instant of a path. Their partial derivatives are exact, from the same call of the
    compiled transcription as the values. Names are those of the problem, where signs that OpenMDAO does not allow are
    replaced: `k.half_width` is `k:half_width`, and several constraints of one name are `force`, `force_2`, ... Units
    are those that the model declares, as far as OpenMDAO knows them.

    - `declared`: whether the component declares its design variables, objective and constraints, with their bounds and
      typical magnitudes. Say False if the larger model has others.

    Its inputs are real: a complex step through it (`method="cs"`) is refused, finite differences are not.

    Limits hold at the instants of the problem's grid, as in `al.solve` before it looks between them: a design found is
    certified by `al.solve` of the problem that starts there. Raises `ProblemError` for limits on the worst case and on
    single realisations, which need a search of their own, `MissingExtraError` without OpenMDAO.
    """
    who = "openmdao_component"
    one_of(who, problem, Problem)
    one_of(f"{who}: declared", declared, bool)
    refuse_choices(who, problem.placements)
    for constraint in problem.constraints:
        if is_worst_case(constraint) or is_at_points(constraint):
            raise ProblemError(
                f"{who}: expected limits on statistics; received '{constraint.name}' on single realisations, which are "
                "searched for. Use al.solve, or a limit with sigmas or a probability."
            )
    return _component()(problem, declared)


@functools.cache
def _component() -> Any:
    """The class of components, made once OpenMDAO is needed. Raises `MissingExtraError` if it is not installed."""
    om = optional("openmdao.api", "openmdao_component", "'aleator[openmdao]'")

    class AleatorComponent(om.ExplicitComponent):
        """A problem of `aleator`; made by `al.foreign.openmdao_component`."""

        def __init__(self, problem: Problem, declared: bool):
            super().__init__()
            transcribed = transcribe(problem)
            constraints = transcribed.problem.constraints
            self._program, self._declared = transcribed.program, declared
            decisions = transcribed.places.decisions
            self._decisions = dict(zip(_names(decisions), decisions.values(), strict=True))
            limits = _names((constraint.name for constraint in constraints), taken=self._decisions)
            self._rows: dict[str, slice] = dict(zip(limits, transcribed.rows, strict=True))
            expressions = [problem.objective, *(constraint.expression for constraint in constraints)]
            units = [number_unit(name, problem) for name in decisions]
            units += [expression.unit(units_of(expression, problem)) for expression in expressions]
            names = (*self._decisions, _OBJECTIVE, *self._rows)
            self._units = dict(zip(names, map(as_in_openmdao, units), strict=True))

        def setup(self) -> None:
            """Declare inputs, outputs and partials; with `declared`, the optimisation too."""
            program = self._program
            for name, place in self._decisions.items():
                self.add_input(name, val=np.array(place.decision.initial, dtype=float), units=self._units[name])
                if self._declared:
                    lower, upper = program.lower[place.where], program.upper[place.where]
                    self.add_design_var(name, lower=lower, upper=upper, ref=program.variable_scale[place.where])
            self.add_output(_OBJECTIVE, val=0.0, units=self._units[_OBJECTIVE])
            if self._declared:
                self.add_objective(_OBJECTIVE)
            for name, rows in self._rows.items():
                self.add_output(name, shape=(rows.stop - rows.start,), units=self._units[name])
                if self._declared:
                    lower, upper = program.constraint_lower[rows], program.constraint_upper[rows]
                    bounds = {"equals": lower} if np.array_equal(lower, upper) else {"lower": lower, "upper": upper}
                    self.add_constraint(name, ref=program.constraint_scale[rows], **bounds)
            self.declare_partials("*", "*")

        def compute(self, inputs: Any, outputs: Any) -> None:
            """The objective and all constraints at some decisions."""
            found = self._evaluated(inputs)
            outputs[_OBJECTIVE] = found.objective
            for name, rows in self._rows.items():
                outputs[name] = found.constraints[rows]

        def compute_partials(self, inputs: Any, partials: Any) -> None:
            """Their derivatives, from the same call of the model."""
            found = self._evaluated(inputs)
            for decision, place in self._decisions.items():
                partials[_OBJECTIVE, decision] = found.gradient[place.where]
                for name, rows in self._rows.items():
                    partials[name, decision] = found.jacobian[rows, place.where]

        def _evaluated(self, inputs: Any) -> Evaluation:
            decisions = np.concatenate([np.ravel(inputs[name]) for name in self._decisions])
            if np.iscomplexobj(decisions):
                raise ProblemError(
                    f"openmdao_component: '{self.pathname}' expected real inputs; received complex ones, of a complex "
                    "step. Its partials are exact by themselves: check them by check_partials(method='fd'), and "
                    "approximate a model that contains it by method='fd'."
                )
            found = self._program.evaluate(decisions)
            if not found.is_finite:
                values = {name: np.array(inputs[name]) for name in self._decisions}
                raise om.AnalysisError(f"The model has no finite values or derivatives at {values}.")
            return found

    return AleatorComponent


def _names(given: Iterable[str], taken: Collection[str] = ()) -> list[str]:
    """Names that OpenMDAO allows, each once, and none of those `taken`, of which `objective` always is one."""
    found: list[str] = []
    for name in given:
        plain = re.sub(r"[^\w:]+", "_", name.replace(".", ":")).strip("_") or "constraint"
        plain = plain if plain[0].isalpha() else f"of_{plain}"
        free = (f"{plain}_{i}" if i > 1 else plain for i in count(1))
        found.append(next(one for one in free if one not in (*found, *taken, _OBJECTIVE)))
    return found


def as_in_openmdao(unit: str) -> str | None:
    """A unit in OpenMDAO's spelling, `m²/s⁴` as `m**2/s**4`; None where it is unknown to OpenMDAO or to us.

    It is taken only if it has the same size there as here. So `°C` is unknown, which OpenMDAO converts with an offset:
    a standard deviation has none.
    """
    from openmdao.utils.units import convert_units

    measured = measure(unit)
    if measured is None or not measured.powers.keys() <= _ROOTS.keys():
        return None
    powered = re.sub(r"[⁻⁺]?[⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda found: f"**{found[0].translate(_SUPERSCRIPTS)}", unit.strip())
    factors = re.sub(r"\s*[·⋅×.]\s*|(?<=[\w)])\s+(?=[\w(])", "*", powered.replace("^", "**"))
    text, powers = factors.replace("°", "deg"), {**measured.powers, "radian": measured.angles}
    base = "*".join(["m/m", *(f"{_ROOTS[name]}**{power}" for name, power in powers.items() if power)])
    try:
        size = float(convert_units(1.0, text, base))  # pyright: ignore
    except Exception:  # whatever Python raises where OpenMDAO evaluates the text
        return None
    return text if math.isclose(size, measured.size, rel_tol=_DIGITS) else None
