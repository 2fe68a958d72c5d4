"""Where results come from: versions, machine, seeds, times and digests, by which a number can be traced to its run."""

import hashlib
import os
import platform
from collections.abc import Iterator, Mapping
from importlib import metadata
from typing import Any

import numpy as np

from aleator.reporting._blocks import Block, Section, Table
from aleator.reporting._nested import leaves
from aleator.reporting._numbers import count, number
from aleator.solution import Solution
from aleator.sweep import Calibration, Front, TradeOff
from aleator.validation import Evidence

_LIBRARIES = ("jax", "jaxlib", "equinox", "diffrax", "numpy", "scipy", "casadi", "unopy")
# So many digits tell apart the designs of any study, and can be read aloud.
_DIGITS = 12
_SIGNED_BY = ("Prepared", "Checked", "Released")


def design_digest(solution: Solution) -> str:
    """Twelve digits that stand for a design: its equations, its decisions and its objective.

    They change with any of these, and are the same on this page and in `designs.json`.
    """
    numbers = np.array([*solution.vector, solution.objective], dtype=float)
    return _digest(solution.problem.physics.text.encode() + numbers.tobytes())


def provenance(results: Mapping[str, Any]) -> Section:
    """The section of a page on where its numbers come from, with lines to sign; empty without results."""
    rows = list(_rows(results))
    note = (
        "A design's digest changes with its equations, its decisions or its objective, and stands in designs.json as "
        "well. The same seed draws the same systems."
    )
    header = ["Result", "Digest of its design", "Computed by", "Seed", "Seconds"]
    blocks: list[Block] = [
        Table("Results", header, rows, note),
        Table("Program and machine", ["", ""], [[name, said] for name, said in environment().items()]),
        Table("Sign-off", ["", "Name", "Date", "Signature"], [[one, "", "", ""] for one in _SIGNED_BY]),
    ]
    return Section("Where this comes from", blocks if rows else [])


def environment() -> dict[str, str]:
    """The versions and the machine of this process, in words."""
    import aleator

    return {
        "aleator": aleator.__version__,
        "Python": f"{platform.python_version()} ({platform.python_implementation()})",
        "Libraries": ", ".join(f"{name} {metadata.version(name)}" for name in _LIBRARIES if _is_installed(name)),
        "Machine": f"{platform.node()}: {platform.system()} {platform.release()}, {platform.machine()}",
        "Processor cores": count(os.cpu_count() or 1),
    }


def _is_installed(name: str) -> bool:
    try:
        metadata.version(name)
    except metadata.PackageNotFoundError:
        return False
    return True


def _rows(results: Mapping[str, Any]) -> Iterator[list[str]]:
    for names, one in leaves(results):
        here = ": ".join(names)
        if isinstance(one, Solution):
            yield [here, design_digest(one), one.effort.solver, "–", _seconds(_time_of(one))]
        elif isinstance(one, Evidence):
            yield [here, design_digest(one.solution), *_sampled(one)]
        elif isinstance(one, Calibration):
            yield [here, design_digest(one.solution), f"{count(len(one.trials))} trials", *_of_confirmation(one)]
        elif isinstance(one, Front | TradeOff) and one.solutions:
            yield [here, *_of_front(one.solutions)]


def _sampled(evidence: Evidence) -> list[str]:
    return [f"{count(evidence.samples)} fresh systems", str(evidence.seed), _seconds(evidence.seconds)]


def _of_confirmation(found: Calibration) -> list[str]:
    return ["–", "–"] if found.evidence is None else [str(found.evidence.seed), _seconds(found.evidence.seconds)]


def _of_front(solutions: Any) -> list[str]:
    """A front's row: one digest for all of its designs."""
    together = _digest("".join(map(design_digest, solutions)).encode())
    solvers = ", ".join(dict.fromkeys(one.effort.solver for one in solutions))
    return [together, f"{count(len(solutions))} designs: {solvers}", "–", _seconds(sum(map(_time_of, solutions)))]


def _time_of(solution: Solution) -> float:
    times = solution.effort.times
    return times.compile_ + times.solve


def _seconds(value: float) -> str:
    return number(value, 3)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:_DIGITS]
