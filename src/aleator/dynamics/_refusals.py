"""Refusals before a simulation: numbers not realised yet, and signals that do not cover the grid."""

from collections.abc import Mapping
from typing import Any

import jax
from jax.core import Tracer

from aleator._core.border import refuse_missing
from aleator._core.errors import ProblemError
from aleator._core.leaves import is_leaf, named_leaves
from aleator.dynamics._grid import Grid
from aleator.dynamics._system import System, check_inputs
from aleator.trajectories import AbstractSignal


def refuse_unrealised(**parts: Any) -> None:
    """Raise `ProblemError` if a distribution or a decision is left in the parts to simulate; traced numbers pass."""
    for name, leaf in named_leaves(parts):
        refuse_missing(name, leaf)
    found = [
        f"'{jax.tree_util.keystr(path, simple=True, separator='.')}' is a {type(leaf).__name__}"
        for path, leaf in jax.tree_util.tree_leaves_with_path(parts, is_leaf=is_leaf)
        if is_leaf(leaf)
    ]
    if found:
        raise ProblemError(
            f"simulate: expected one realised system, with plain numbers throughout; received {', '.join(found)}. "
            "Replace these by numbers, declare an al.Problem, or pass a function that simulates to al.expand or "
            "al.references.monte_carlo, which realise the system."
        )


def check_signals(system: System, grid: Grid, inputs: Mapping[str, Any]) -> None:
    """Refuse missing or unknown inputs, inputs that are not signals, and signals not known on the whole grid.

    The system's own signals are checked too. The grid extends to the largest final time that may be chosen; where its
    numbers are traced, the span is not checked.
    """
    check_inputs(system, inputs)
    for name, signal in inputs.items():
        if not isinstance(signal, AbstractSignal):
            raise ProblemError(
                f"Input '{name}' must be a signal, such as al.Tabulated(times, values); "
                f"received {type(signal).__name__}."
            )
    own = {f"Signal '{name}' of {system.title}": signal for name, signal in system.signals().items()}
    for who, signal in (own | {f"Input '{name}'": signal for name, signal in inputs.items()}).items():
        if not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((signal, grid))):
            _check_span(who, signal, grid)


def _check_span(who: str, signal: AbstractSignal, grid: Grid) -> None:
    # These are known even while a function that simulates is traced.
    with jax.ensure_compile_time_eval():
        first, last = signal.span()
    start, end = float(grid.t_start), grid.latest
    if start < first or end > last:
        raise ProblemError(
            f"{who} is known from {first:g} to {last:g} s, but the grid runs from {start:g} to {end:g} s. Give it for "
            "the whole time, or change the grid."
        )
