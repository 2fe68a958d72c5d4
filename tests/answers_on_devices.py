"""A solve, evidence, an expansion and a sample on whatever devices JAX has: `python answers_on_devices.py`.

Prints one JSON object: the numbers, to the last bit, and what was traced, compiled and run where.
"""

import json
import sys

import jax
import jax.numpy as jnp
import numpy as np

import aleator as al
from aleator._core.compilation import Compiled
from aleator._core.parallel import here, over_devices
from aleator.transcription.sequential._evaluator import CONTRIBUTE
from aleator.validation._batches import SIMULATE
from zoo import Oscillator, sine


def springs(place):
    """Enough points, steps and decisions that the points are simulated in two parts."""
    stiffness = al.Uniform(al.Decision(5.0, 1.0, 20.0), half_width=0.5)
    return al.Problem(
        Oscillator(al.LogNormal(mean=1.0, std=0.05), al.Decision(0.5, 0.1, 3.0), stiffness, place),
        grid=al.Grid(2.0, 1000),
        inputs={"force": sine(3.0)},
        minimize=al.rms("v").mean,
        subject_to=[al.path("x").at_most(0.6, sigmas=2.0)],
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
    solution = al.solve(springs(np.asarray(0.1)))
    evidence = al.validate(solution, 550, batch=50)
    model = {"a": al.Normal(0.5, 0.1), "b": al.Uniform.bounds(0.5, 1.5)}
    expanded = al.expand(lambda at: jnp.exp(jnp.sin(at["a"] * at["b"])), model)
    sample = al.references.monte_carlo(called_back, model, 300, batch=70)
    return {
        "ok": solution.ok,
        "decisions": bits(solution.vector),
        "objective": bits(solution.objective),
        "sampled": bits(np.concatenate([np.ravel(one.mean) for one in evidence.functionals.values()])),
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


def main():
    al.threads(4)
    last = jax.local_devices()[-1]
    told = {"answers": answers()}
    told |= {"parts": CONTRIBUTE.compilations, "batches": SIMULATE.compilations}
    told |= {"devices": len(jax.local_devices()), "turns": at_each_turn()}
    with jax.default_device(last):
        told["told"] = [here().id, at_each_turn()]
    if "placed" in sys.argv:
        put = al.solve(springs(jax.device_put(np.asarray(0.1), last)))
        told["placed"] = bits(put.vector)
    print(json.dumps(told))


if __name__ == "__main__":
    main()
