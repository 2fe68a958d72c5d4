"""How long a person waits for the first answer: fresh processes, from import to answer, compiled anew and found again.

    python benchmarks/first_answer.py [--repeats 3] [--peers]

Each line is the median over fresh processes of its kind. The first run of a problem has an empty folder of compiled
programs; the second has what the first one left. JAX alone is the peer of the import, and its time the unit of the
others. Programs and traced equations, those inside others included, are counted from the declaration to the answer of a
first run. `--peers` lets CasADi construct and solve two of the problems (3 minutes). What a limit takes to compile is
the processor time of the suspension's first solution with it, less that of the next one in the same process. A system
is simulated with some numbers, and then with others.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
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
    "six-axis arm": "six_axis_arm",
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
COUNTED = """
import warnings, jax
import aleator as al
from {module} import robust_problem

def equations_in(jaxpr):
    inner = [part for one in jaxpr.eqns for part in jax.tree.leaves(one.params) if hasattr(part, "eqns")]
    return len(jaxpr.eqns) + sum(map(equations_in, inner))

def lower(traced, *arguments, **options):
    equations.append(equations_in(traced.jaxpr))
    return lowered(traced, *arguments, **options)

def heard(event, seconds, **_):
    if event.endswith("backend_compile_duration"):
        programs.append(seconds)

programs, equations = [], []
lowered, jax.stages.Traced.lower = jax.stages.Traced.lower, lower
jax.monitoring.register_event_duration_secs_listener(heard)
warnings.simplefilter("ignore")
al.solve(robust_problem())
print(len(programs), sum(equations))
"""
PEERS = {
    "suspension": """
from casadi_suspension import suspension
peer = suspension()
print(peer.constructed, peer.solved)
""",
    "two-link arm, least time": """
from casadi_motion import PLANAR_GOAL, PLANAR_START, pick_and_place_time, straight_line
plan = pick_and_place_time(1.0, perturbation=0.5, seed=5, limited_memory=True)
print(plan.construction, plan.solution)
""",
}

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

INTEGRATORS = ("RungeKutta4", "Tsit5", "Rodas5P")
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


HERE = Path(__file__).parent


def ran(script: str, folder: str) -> list[float]:
    """The numbers that a fresh process prints, with compiled programs kept in a folder."""
    # An installed package has its bytecode.
    others = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "PYTHONDONTWRITE"))}
    paths = os.pathsep.join(filter(None, [str(HERE.parent / "tests"), others.get("PYTHONPATH", "")]))
    own = others | {"ALEATOR_CACHE": folder, "PYTHONPATH": paths}
    done = subprocess.run([sys.executable, "-c", script], env=own, cwd=HERE, capture_output=True, text=True, check=True)
    return [float(word) for word in done.stdout.split()]


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--repeats", type=int, default=3)
    options.add_argument("--peers", action="store_true", help="let CasADi construct and solve the same problems")
    arguments = options.parse_args()
    repeats, unit = arguments.repeats, 1.0
    print(f"{os.cpu_count()} cores, Python {sys.version.split()[0]}, medians of {repeats} processes")
    with tempfile.TemporaryDirectory() as folder:
        for name, work in IMPORTS.items():
            ran(TIMED.format(work=work), folder)
            seconds = median(ran(TIMED.format(work=work), folder)[0] for _ in range(repeats))
            unit = seconds if name == "JAX alone" else unit
            print(f"import, {name:<28} {seconds:6.2f} s", flush=True)
    for name, module in STUDIES.items():
        runs = []
        for _ in range(repeats):
            with tempfile.TemporaryDirectory() as folder:
                runs.append([ran(SOLVED.format(module=module), folder) for _ in range(2)])
        first, second = (median(run[k][2] for run in runs) for k in range(2))
        declared = median(run[0][1] for run in runs)
        with tempfile.TemporaryDirectory() as folder:
            programs, equations = ran(COUNTED.format(module=module), folder)
        print(
            f"{name:<28} first {first:6.2f} s = {first / unit:.1f} units, again {second:6.2f} s = {second / unit:.1f} "
            f"units; declared in {declared:.2f} CPU s; {programs:.0f} programs, {equations:.0f} equations",
            flush=True,
        )
        if arguments.peers and name in PEERS:
            constructed, solved = ran(PEERS[name], HERE.name)
            print(f"{'':<28} CasADi constructs in {constructed:6.2f} s and solves in {solved:.2f} s", flush=True)
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
