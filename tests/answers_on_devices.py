"""A solve, evidence, an expansion and a sample on whatever devices JAX has: `python answers_on_devices.py`.

Prints one JSON object: the numbers, to the last bit, and what was traced, compiled and run where.
"""

import json
import sys
import threading

import jax
import jax.numpy as jnp
import numpy as np

import aleator as al
from aleator._core.compilation import Compiled
from aleator._core.devices import here, over_devices
from aleator.transcription.sequential._evaluator import CONTRIBUTE
from aleator.validation._sampling import SIMULATE_BATCH

TRACED: list[int] = []
RUN_BY: set[int] = set()


def hear(event, duration_secs, **about):
    if event.endswith("jaxpr_trace_duration") and str(about.get("fun_name")).startswith("flat"):
        TRACED.append(threading.get_ident())


class Spring(al.System):
    """A mass on a damped spring, pushed from its rest."""

    states = ("x", "v")
    stiffness: al.Number
    damping: al.Number
    mass: al.Number
    push: al.Number

    def initial(self):
        return {"v": 1.0}

    def rhs(self, t, z):
        RUN_BY.add(threading.get_ident())
        return z.v, (self.push[0] - self.stiffness * z.x - self.damping * z.v) / self.mass

    def outputs(self, t, z):
        return {"x": z.x, "pull": self.stiffness * z.x + self.damping * z.v}


def springs(push):
    """Enough points, steps and decisions that the points are simulated in two parts."""
    stiffness = al.Uniform(al.Decision(5.0, 1.0, 20.0), half_width=0.5)
    return al.Problem(
        Spring(stiffness, al.Decision(0.5, 0.1, 3.0), al.Normal(1.0, 0.05), push),
        grid=al.Grid(2.0, 1000),
        minimize=al.rms("pull").mean,
        subject_to=[al.path("x").at_most(0.4, sigmas=2.0)],
        expansion=al.Expansion(order=5, points=70),
    )


def called_back(model):
    """A function that leaves JAX, as foreign models do."""
    angle = model["a"] * model["b"]
    outside = jax.pure_callback(np.tanh, jax.ShapeDtypeStruct((), float), angle, vmap_method="expand_dims")
    return {"inside": jnp.exp(jnp.sin(angle)), "outside": outside}


def bits(numbers):
    return [float(one).hex() for one in np.asarray(numbers, dtype=float).ravel()]


def answers():
    """The numbers, by name."""
    problem = springs(np.ones(2))
    solution = al.solve(problem)
    evidence = al.validate(solution, 550, batch=50)
    means = [np.asarray(one.mean) for one in evidence.functionals.values()]
    model = {"a": al.Normal(0.5, 0.1), "b": al.Uniform.bounds(0.5, 1.5)}
    expanded = al.expand(lambda at: jnp.exp(jnp.sin(at["a"] * at["b"])), model)
    sample = al.references.monte_carlo(called_back, model, 300, batch=70)
    return {
        "ok": solution.ok,
        "decisions": bits(solution.vector),
        "objective": bits(solution.objective),
        "sampled": bits(np.concatenate([one.ravel() for one in means])),
        "violations": [one.count for one in evidence.violations.values()],
        "expanded": bits([expanded.mean, expanded.std]),
        "sample": {name: bits(values) for name, values in sample.values.items()},
    }


def at_each_turn():
    """The numbers of the devices that six items in turn are computed on, also in what executables return there."""
    program = Compiled(lambda x: 2.0 * x)
    program.prepare(jnp.zeros(3))

    def work(item):
        found = program(jnp.full(3, float(item)))
        np.testing.assert_array_equal(found, np.full(3, 2.0 * item))
        return [here().id, *(one.id for one in found.devices())]

    return list(over_devices(work, range(6)))


def failed_in_its_turn():
    """What items give before the one that fails."""
    found = []
    try:
        for one in over_devices(lambda item: 1 // (3 - item), range(6)):
            found.append(one)
    except ZeroDivisionError:
        found.append("failed")
    return found


def main():
    al.threads(4)
    jax.monitoring.register_event_duration_secs_listener(hear)
    last = jax.local_devices()[-1]
    told = {"answers": answers(), "here": threading.get_ident(), "run_by": [*RUN_BY], "traced": [*TRACED]}
    told |= {"parts": CONTRIBUTE.compilations, "batches": SIMULATE_BATCH.compilations}
    told |= {"devices": len(jax.local_devices()), "turns": at_each_turn(), "failed": failed_in_its_turn()}
    with jax.default_device(last):
        told["told"] = [here().id, at_each_turn()]
    if "placed" in sys.argv:
        put = al.solve(springs(jax.device_put(np.ones(2), last)))
        told["placed"] = bits(put.vector)
    print(json.dumps(told))


if __name__ == "__main__":
    main()
