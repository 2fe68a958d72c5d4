"""How long a person waits for the first answer: fresh processes, from import to answer, compiled anew and found again.

    python benchmarks/first_answer.py [--repeats 3]

Each line is the median over fresh processes of its kind. The first run of a problem has an empty folder of compiled
programs; the second has what the first one left. JAX alone is the peer of the import. What a limit takes to compile is
the processor time of the suspension's first solution with it, less that of the next one in the same process. A system
is simulated with some numbers, and then with others.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from statistics import median

IMPORTS = {
    "JAX alone": "import jax",
    "NumPy and SciPy alone": "import numpy, scipy.special",
    "aleator": "import aleator",
}
STUDIES = {
    "suspension": "aleator.studies.suspension",
    "two-link arm, least effort": "aleator.studies.pick_and_place_effort",
    "two-link arm, least time": "aleator.studies.pick_and_place_time",
    "six-axis arm": "aleator.studies.six_axis_arm",
}
TIMED = """
import time; started = time.perf_counter()
{work}
print(time.perf_counter() - started)
"""
SOLVED = """
import time, warnings; started = time.perf_counter()
import aleator as al
from {module} import robust_problem
imported, cpu = time.perf_counter(), time.process_time()
problem = robust_problem()
declared = time.process_time() - cpu
warnings.simplefilter("ignore")
al.solve(problem)
print(imported - started, declared, time.perf_counter() - started)
"""

LIMITS = {
    "a limit on the worst case": "worst_case=True",
    "a limit with a probability": "probability=0.9",
}
COMPILED = """
import time, warnings
import aleator as al
from aleator.studies.suspension import GRID, RIDE, nominal, road
warnings.simplefilter("ignore")
taken = []
for _ in range(2):
    cpu = time.process_time()
    limit = al.path("travel").within(-0.25, 0.25, {limit})
    al.solve(al.Problem(nominal(), grid=GRID, inputs={{"road": road()}}, minimize=RIDE.mean, subject_to=[limit]))
    taken.append(time.process_time() - cpu)
print(taken[0] - taken[1])
"""

INTEGRATORS = ("RungeKutta4", "Tsit5")
SIMULATED = """
import time
import aleator as al

class VanDerPol(al.System):
    states = ("x", "v")
    mu: float

    def initial(self):
        return {{"x": 1.0}}

    def rhs(self, t, z):
        return z.v, self.mu * (1 - z.x**2) * z.v - z.x

    def outputs(self, t, z):
        return {{"x": z.x}}

for mu in (1.0, 1.5):
    cpu = time.process_time()
    al.simulate(VanDerPol(mu), al.Grid(10.0, 1000), integrator=al.integrators.{integrator}())["x"].block_until_ready()
    print(time.process_time() - cpu)
"""


def ran(script: str, folder: str) -> list[float]:
    """The numbers that a fresh process prints, with compiled programs kept in a folder."""
    # An installed package has its bytecode.
    others = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "PYTHONDONTWRITE"))}
    own = others | {"ALEATOR_CACHE": folder}
    done = subprocess.run([sys.executable, "-c", script], env=own, capture_output=True, text=True, check=True)
    return [float(word) for word in done.stdout.split()]


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--repeats", type=int, default=3)
    repeats = options.parse_args().repeats
    print(f"{os.cpu_count()} cores, Python {sys.version.split()[0]}, medians of {repeats} processes")
    with tempfile.TemporaryDirectory() as folder:
        for name, work in IMPORTS.items():
            ran(TIMED.format(work=work), folder)
            seconds = median(ran(TIMED.format(work=work), folder)[0] for _ in range(repeats))
            print(f"import, {name:<28} {seconds:6.2f} s", flush=True)
    for name, module in STUDIES.items():
        runs = []
        for _ in range(repeats):
            with tempfile.TemporaryDirectory() as folder:
                runs.append([ran(SOLVED.format(module=module), folder) for _ in range(2)])
        first, second = (median(run[k][2] for run in runs) for k in range(2))
        declared = median(run[0][1] for run in runs)
        print(f"{name:<28} first {first:6.2f} s, again {second:6.2f} s; declared in {declared:.2f} CPU s", flush=True)
    for name, limit in LIMITS.items():
        taken = []
        for _ in range(repeats):
            with tempfile.TemporaryDirectory() as folder:
                taken.append(ran(COMPILED.format(limit=limit), folder)[0])
        print(f"{name:<28} compiled in {median(taken):6.2f} CPU s", flush=True)
    for integrator in INTEGRATORS:
        with tempfile.TemporaryDirectory() as folder:
            runs = [ran(SIMULATED.format(integrator=integrator), folder) for _ in range(repeats)]
        first, second = (median(run[k] for run in runs) for k in range(2))
        print(
            f"al.simulate, {integrator:<15} first {first:6.2f} CPU s, other numbers {1e3 * second:.1f} CPU ms",
            flush=True,
        )


if __name__ == "__main__":
    main()
