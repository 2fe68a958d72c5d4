"""Whether the code of a problem is still what it was: a digest of its equations, and a reading of its code.

The digest is taken of traced equations, and tells problems apart wherever their code differs, also where their fields
are alike. Tracing takes a while, so that it is done once, as long as all that the code reads stays the same. Where a
reading leaves a doubt, equations are traced at every use.
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

# Enough for a session's problems, and for as many states of the code of each.
_KEPT, _STATES = 64, 8


class Digest(NamedTuple):
    """A digest of equations; `whole` unless they call Python code, of which no equation tells what it computes."""

    text: str
    whole: bool


class _Known(NamedTuple):
    """A state of some code.

    - `physics`: what stands for its equations; `reading`: what the code reads;
    - `moving`: what tracing it changes by itself, such as a list of all calls, without a change of the equations.
    """

    physics: str
    digest: Digest
    reading: Reading
    moving: frozenset[Place]

    def reads(self, reading: Reading) -> bool:
        """Whether a later reading is the same."""
        return self.reading.reads == reading.reads or not self.changed(reading)

    def changed(self, reading: Reading) -> dict[Place, str]:
        """Where a later reading differs, and in which words."""
        found = changed_places(self.reading, reading)
        return {place: how for place, how in found.items() if place not in self.moving}


_known: OrderedDict[Hashable, list[_Known]] = OrderedDict()
_lock = threading.Lock()


def physics_of(problem: AbstractProblem, trace: Callable[[], Digest]) -> str:
    """What stands for the equations of a problem as its code is now; `trace` is called only if that is not known.

    Raises `ProblemError` if its code computes something else at every trace.
    """
    parts = _code_of(problem)
    structure, reading = _structure(parts), read_code(parts)
    with _lock:
        states = list(_known.get(structure, ()))
    for one in states:
        if not (reading.doubts or one.moving) and one.reads(reading):
            return one.physics
    digest, moving = steadily(type(problem.system).__name__, parts, trace, told=lambda digest: digest)
    # Where equations do not tell what is computed, problems pass for the same if their code reads the same.
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
    """What the code of a problem reads now that it did not when `problem.physics` was taken; empty if nothing.

    What cannot be told is not named.
    """
    reading = read_code(_code_of(problem))
    with _lock:
        states = [one for every in _known.values() for one in every if one.physics == problem.physics]
    if not states or any(one.reads(reading) for one in states):
        return ""
    found = min((one.changed(reading) for one in states), key=len)
    return ", ".join(f"{place} {how}" for place, how in list(found.items())[:3])


def refuse_changed_code(problem: AbstractProblem, *_: Any) -> None:
    """Raise `ProblemError` if a problem's code is not what its equations were taken from, once it is compiled.

    That may have happened at any time since then; whoever uses a solution asks beforehand (`refuse_changed`).
    """
    if found := changes(problem):
        raise ProblemError(
            f"The code of {type(problem.system).__name__} is not what it was when its problem was last solved or "
            f"declared: {found}. Solve it again, or put back what has changed."
        )


def _code_of(problem: AbstractProblem) -> tuple[Any, ...]:
    """The parts of a problem that hold a user's code, with their distributions: the same for its deterministic twin.

    Grid and integrator are none: the same problem on a finer grid, by which its own is judged, has the same code.
    """
    simulation = uncertain_again(problem.simulation)
    return simulation.system, simulation.inputs, problem.objective, problem.constraints


def _structure(parts: Any) -> Hashable:
    """Equal for parts that differ in numbers alone; never equal where that cannot be told."""
    leaves, structure = jax.tree.flatten(parts)
    found = structure, tuple(map(_told, leaves))
    try:
        hash(found)
    except TypeError:
        return object()
    return found


def _told(leaf: Any) -> Hashable:
    """What of a leaf is structure: the shape alone of numbers that are traced."""
    if is_number(leaf):
        return np.shape(leaf)
    return (leaf.shape, str(leaf.dtype)) if isinstance(leaf, jax.Array) else (type(leaf), leaf)
