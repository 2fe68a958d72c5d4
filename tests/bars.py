"""A bar whose front is known: as a model that other processes can import, and as the text of a study file."""

import os
import signal
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import aleator as al

# stress = load / width, whose mean plus three standard deviations are NEEDED / width.
NEEDED = 1.0 + 3.0 * 0.3 / np.sqrt(3.0)

# The same bar as a file that a user writes.
FILE = '''"""A bar that carries an uncertain load."""

import aleator as al


class Bar(al.AlgebraicSystem):
    width: al.Number = al.parameter("mm", positive=True)
    load: al.Number = al.parameter("kN")
    units = {"stress": "kN/mm", "mass": "mm"}

    def outputs(self):
        return {"stress": self.load / self.width, "mass": self.width}


stress = al.output("stress")
bar = Bar(al.Decision(4.0, 0.1, 10.0), al.Uniform(1.0, half_width=0.3))
strong = (stress.mean + 3 * stress.std <= 0.5).named("stress")
problem = al.Problem(bar, minimize=al.output("mass").mean, subject_to=[strong])
'''


class Bar(al.AlgebraicSystem):
    """A bar of some width under an uncertain load."""

    width: al.Number
    load: al.Number

    def outputs(self):
        return {"stress": self.load / self.width, "mass": self.width}


class Wave(al.AlgebraicSystem):
    """A wave that no polynomial of low order follows."""

    width: al.Number
    off: al.Number

    def outputs(self):
        return {"wave": jnp.sin(8.0 * self.off) * self.width, "width": self.width}


STRESS, MASS = al.output("stress"), al.output("mass")


def bar(load: float = 1.0, highest: float = 10.0) -> al.Problem:
    """The lightest bar that is strong enough, no wider than `highest`."""
    model = Bar(al.Decision(4.0, 0.1, highest), al.Uniform(load, half_width=0.3))
    strong = (STRESS.mean + 3 * STRESS.std <= 0.5).named("stress")
    return al.Problem(model, minimize=MASS.mean, subject_to=[strong])


class Valleys(al.AlgebraicSystem):
    """A depth with a minimum on either side."""

    place: al.Number
    off: al.Number

    def outputs(self):
        return {"depth": (self.place**2 - 1.0) ** 2 + 0.2 * self.place + self.off}


def two_valleys() -> al.Problem:
    """The deeper valley is on the left."""
    return al.Problem(Valleys(al.Decision(0.5, -2.0, 2.0), al.Normal(0.0, 0.1)), minimize=al.output("depth").mean)


def scattered(model):
    """A sum, and a row of numbers."""
    return {"sum": model["off"] + model["more"], "row": jnp.stack([model["off"] ** 2, jnp.sin(model["more"])])}


def dies_once(mark: str, number: int) -> int:
    """Twice a number; the first process that is asked for three dies."""
    if number == 3 and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def dies(number: int) -> int:
    """Never ends well."""
    os.kill(os.getpid(), signal.SIGKILL)
    return number
