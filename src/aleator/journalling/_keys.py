"""Keys of results: digests of all that they follow from, the same in every process."""

import weakref
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple, final

from aleator._core.identity import joined, lasting_digest, versions
from aleator.design import Problem


class Identity(NamedTuple):
    """What a result is: its key, what is done with which model, and digests of all that it follows from, by name."""

    key: str
    what: str
    parts: Mapping[str, str]


@final
class Keys:
    """The keys of the results that this process knows. What follows from a result is identified by its key."""

    def __init__(self) -> None:
        self._keys = dict[int, tuple[weakref.ref[Any], str]]()

    def remember(self, result: Any, key: str) -> None:
        """Note the key of a result. A plain value, such as a list, is told by its content instead."""
        with suppress(TypeError):
            self._keys[id(result)] = weakref.ref(result), key

    def of(self, result: Any) -> str:
        """The key of a known result; empty for anything else."""
        reference, key = self._keys.get(id(result), (None, ""))
        return key if reference is not None and reference() is result else ""

    def identity(self, what: str, given: Mapping[str, Any]) -> Identity:
        """What a result is that follows from what is given. Raises `DoubtError` if another process could not tell."""
        parts = {"versions": versions()}
        for name, one in given.items():
            if isinstance(one, Problem):
                parts |= {name: self.problem_digest(one), "equations": _equations(one)}
            else:
                parts[name] = lasting_digest(self.of(one) or one)
        key = joined([what, *(f"{name} {digest}" for name, digest in sorted(parts.items()))])
        return Identity(key, done_with(what, given), parts)

    def problem_digest(self, problem: Problem) -> str:
        """The part of a key that tells the problem, whatever else a result follows from. Raises `DoubtError`."""
        return lasting_digest(_parts_of(problem), declared=True)


def done_with(what: str, given: Mapping[str, Any]) -> str:
    """What is done, with the name of the model."""
    problem = given.get("problem") or getattr(given.get("solution"), "problem", None)
    return f"{what} {type(problem.system).__name__}" if problem is not None else what


def _parts_of(problem: Problem) -> tuple[Any, ...]:
    """A problem without the digests of its code."""
    return replace(problem.simulation, equations=None), problem.objective, problem.constraints, problem.expansion


def _equations(problem: Problem) -> str:
    """The digest of a problem's code: of its equations, and all of it where they do not show it."""
    return joined([problem.physics.text, "" if problem.is_declared else lasting_digest(_parts_of(problem))])
