"""What it costs to run an FMU in a process of its own: its start, a run, an evaluation of its equations.

`python benchmarks/fmu_processes.py`, which compiles the swinging rod of the tests (needs gcc and FMPy).
"""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

import aleator as al

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from rods import Rods  # pyright: ignore[reportMissingImports]


def milliseconds(call: Callable[[], Any], times: int) -> float:
    """The median time of a call."""
    found = []
    for _ in range(times):
        began = perf_counter()
        call()
        found.append(perf_counter() - began)
    return 1e3 * float(np.median(found))


def main() -> None:
    """Print the times of both ways."""
    with tempfile.TemporaryDirectory() as folder:
        path = Rods(Path(folder))(3)
        print(f"{'ms':>14} {'opened':>9} {'run, ME':>9} {'run, CS':>9} {'rates':>9}")
        for own_process in (False, True):
            began = perf_counter()
            exchange = al.foreign.Fmu(path, own_process=own_process)
            opened = 1e3 * (perf_counter() - began)
            stepping = al.foreign.Fmu(path, own_process=own_process, kind="co-simulation")
            grid = al.Grid(1.0, 100)
            runs = [al.foreign.FmuSimulation(fmu, grid) for fmu in (exchange, stepping)]
            system = al.foreign.FmuSystem(exchange, {"damping": 0.2})
            place = np.array([[0.0, 1.0, 0.0, 0.0, 0.2]])
            times = [milliseconds(lambda run=run: run({"damping": 0.2}), 100) for run in runs]
            asked = "rates", ["damping"], exchange.inputs, exchange.outputs, place
            times.append(milliseconds(lambda values=system._equations._values, asked=asked: values(*asked), 2000))
            name = "own process" if own_process else "here"
            print(f"{name:>14} {opened:9.0f} {times[0]:9.2f} {times[1]:9.2f} {times[2]:9.3f}")


if __name__ == "__main__":
    main()
