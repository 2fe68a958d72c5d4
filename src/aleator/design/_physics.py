"""Detection of changed code: a digest of a problem's traced equations, and a reading of its code.

The digest of the traced equations tells problems with different code apart, even where their fields are equal. Tracing
is slow, so it is repeated only when something that the code reads has changed. Where a reading is inconclusive,
equations are traced at every use.
"""

import threading
import uuid
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import jax
import numpy as np

from aleator._core.arrays import is_number
from aleator._core.code import read_code
from aleator._core.errors import ProblemError
from aleator._core.purity import steadily
from aleator._core.readings import Place, Reading, changed_places
from aleator.design._declaration import AbstractProblem
from aleator.uncertainty import uncertain_again

# Enough for the problems of one run, and for the states of their code.
_KEPT, _STATES = 64, 8


class Digest(NamedTuple):
    """A digest of equations; not `whole` if they call Python code, whose computation the equations do not show."""

    text: str
    whole: bool


class _Known(NamedTuple):
    """A known state of a problem's code.

    - `physics`: the digest of its equations; `reading`: what the code reads;
    - `moving`: what tracing itself changes, such as a list of all calls, without changing the equations.
    """

    physics: str
    digest: Digest
    reading: Reading
    moving: frozenset[Place]

    def reads(self, reading: Reading) -> bool:
        """Whether a later reading is the same."""
        return self.reading.reads == reading.reads or not self.changed(reading)

    def changed(self, reading: Reading) -> dict[Place, str]:
        """Where a later reading differs, and how, in words."""
        found = changed_places(self.reading, reading)
        return {place: how for place, how in found.items() if place not in self.moving}


_known: OrderedDict[Hashable, list[_Known]] = OrderedDict()
_lock = threading.Lock()


def equations_digest(problem: AbstractProblem) -> str:
    """The digest of a problem's equations, without what is drawn at random where equations do not show all."""
    return problem.physics.partition(" ")[0]


def physics_of(problem: AbstractProblem, trace: Callable[[], Digest]) -> str:
    """The digest of a problem's equations with its present code; `trace` is called only if it is not known.

    Raises `ProblemError` if its code computes something different at every trace.
    """
    parts = _code_of(problem)
    structure, reading = _structure(parts), read_code(parts)
    with _lock:
        states = list(_known.get(structure, ()))
    for one in states:
        if not (reading.doubts or one.moving) and one.reads(reading):
            return one.physics
    digest, moving = steadily(type(problem.system).__name__, parts, trace, told=lambda digest: digest)
    # Where equations do not show what is computed, problems count as equal if their code reads the same.
    alike = (one for one in states if one.digest == digest and (digest.whole or one.reads(reading)))
    same = next(alike, None)
    # Like no other, in whatever process: programs are kept on the disk too.
    physics = same.physics if same else digest.text + ("" if digest.whole else f" {uuid.uuid4().hex}")
    with _lock:
        _known[structure] = [_Known(physics, digest, reading, moving), *_known.pop(structure, ())][:_STATES]
        while len(_known) > _KEPT:
            _known.popitem(last=False)
    return physics


def changes(problem: AbstractProblem) -> str:
    """What has changed, in what the code of a problem reads, since `problem.physics` was taken; empty if nothing.

    Changes that cannot be detected are not named.
    """
    reading = read_code(_code_of(problem))
    with _lock:
        states = [one for every in _known.values() for one in every if one.physics == problem.physics]
    if not states or any(one.reads(reading) for one in states):
        return ""
    found = min((one.changed(reading) for one in states), key=len)
    return ", ".join(f"{place} {how}" for place, how in list(found.items())[:3])


def refuse_changed_code(problem: AbstractProblem, *_: Any) -> None:
    """Raise `ProblemError` if a problem's code has changed since its equations were traced; called at compilation.

    It may have changed at any time since then; users of a solution check beforehand (`refuse_changed`).
    """
    if found := changes(problem):
        raise ProblemError(
            f"The code of {type(problem.system).__name__} has changed since its problem was last solved or declared: "
            f"{found}. Solve it again, or undo the change."
        )


def _code_of(problem: AbstractProblem) -> tuple[Any, ...]:
    """The parts of a problem with a user's code, with their distributions: the same for its deterministic version.

    Grid and integrator are not among them: the same problem on a finer grid, used for verification, has the same code.
    """
    simulation = uncertain_again(problem.simulation)
    return simulation.system, simulation.inputs, problem.objective, problem.constraints


def _structure(parts: Any) -> Hashable:
    """Equal for parts that differ only in numbers; never equal where that cannot be determined."""
    leaves, structure = jax.tree.flatten(parts)
    found = structure, tuple(map(_told, leaves))
    try:
        hash(found)
    except TypeError:
        return object()
    return found


def _told(leaf: Any) -> Hashable:
    """The static part of a leaf: only the shape for traced numbers."""
    if is_number(leaf):
        return np.shape(leaf)
    return (leaf.shape, str(leaf.dtype)) if isinstance(leaf, jax.Array) else (type(leaf), leaf)
