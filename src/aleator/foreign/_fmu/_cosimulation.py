"""Co-simulation: the FMU steps by itself from one instant to the next."""

import itertools

import numpy as np
from jaxtyping import Float

from aleator.foreign._fmu._inputs import Inputs
from aleator.foreign._fmu._instance import Instance


def stepped(
    instance: Instance, outputs: list[int], inputs: Inputs, times: Float[np.ndarray, " instants"]
) -> Float[np.ndarray, "instants outputs"]:
    """The outputs at all instants. During a step, each input has its value in the middle of it."""
    inputs.apply(instance, float(times[0]))
    found = [instance.get(outputs)]
    for now, then in itertools.pairwise(times):
        inputs.apply(instance, float(now + then) / 2)
        instance.step(float(now), float(then - now))
        found.append(instance.get(outputs))
    return np.stack(found)
