"""Small models and problems whose answers are known in closed form, shared by the tests."""

from typing import Any

import numpy as np

import aleator as al


class Oscillator(al.System):
    """A mass on a spring and a damper, pushed by a force."""

    states = ("x", "v")

    m: Any = al.parameter("kg", positive=True)
    c: Any = al.parameter("N s/m")
    k: Any = al.parameter("N/m", positive=True)
    x0: Any = 0.0

    def rhs(self, t, z, force):
        return z.v, (force - self.c * z.v - self.k * z.x) / self.m

    def outputs(self, t, z, force):
        return {"x": z.x, "v": z.v, "spring": self.k * z.x}

    def initial(self):
        return {"x": self.x0}


class Decay(al.System):
    """`x' = -rate x` from `x(0) = start`."""

    states = ("x",)

    rate: Any
    start: Any = 1.0

    def rhs(self, t, z):
        return (-self.rate * z.x,)

    def outputs(self, t, z):
        return {"x": z.x}

    def initial(self):
        return {"x": self.start}


class Gain(al.System):
    """No dynamics: the response `gain * theta + shift`, and how far gain and shift are from 3 and 1."""

    states = ("nothing",)

    gain: Any
    theta: Any
    shift: Any = 0.0

    def rhs(self, t, z):
        return (0.0 * z.nothing,)

    def outputs(self, t, z):
        return {
            "response": self.gain * self.theta + self.shift,
            "loss": (self.gain - 3.0) ** 2 + (self.shift - 1.0) ** 2,
            "gain": self.gain,
        }


ONE_STEP = al.Grid(1.0, 1)
LOSS, RESPONSE = al.terminal("loss"), al.terminal("response")
HALF_WIDTH = 0.3
SPREAD = HALF_WIDTH / np.sqrt(3.0)


def gain_problem(upper: float = 2.0, sigmas: float = 1.0, theta: Any = None, **options: Any) -> al.Problem:
    """Choose a gain close to 3 whose response stays below `upper`; `theta` is uniform around 1.

    `gain = upper / (1 + sigmas * SPREAD)` and the loss is `(gain - 3)² + 1`, as long as `gain <= 3`.
    """
    theta = al.Uniform(1.0, half_width=HALF_WIDTH) if theta is None else theta
    return al.Problem(
        Gain(gain=al.Decision(0.5, 0.0, 10.0), theta=theta),
        grid=ONE_STEP,
        minimize=LOSS.mean,
        subject_to=[RESPONSE.at_most(upper, sigmas=sigmas)],
        **options,
    )


def sine(amplitude: float = 1.0, frequency: float = 3.0) -> al.Tabulated:
    times = np.linspace(0.0, 5.0, 501)
    return al.Tabulated(times, amplitude * np.sin(frequency * times))


def oscillator_problem(**options: Any) -> al.Problem:
    """A mass near resonance whose spring is uncertain: the weakest damper that holds it within limits."""
    x = al.path("x")
    defaults: dict[str, Any] = {
        "grid": al.Grid(4.0, 80),
        "inputs": {"force": sine()},
        "minimize": 0.1 * al.value("c") + al.rms("v").mean,
        "subject_to": [x.within(-0.14, 0.14, sigmas=2.0)],
        "expansion": al.Expansion(order=3),
    }
    system = Oscillator(m=1.0, c=al.Decision(0.5, 0.05, 8.0), k=al.Uniform(10.0, half_width=2.0))
    return al.Problem(system, **(defaults | options))


def central_differences(function, point, step):
    """Central differences of an array-valued function: shape (rows, n)."""
    columns = []
    for i, x in enumerate(point):
        h = step * max(abs(x), 1e-3)
        forward, backward = (np.array(point, float) for _ in range(2))
        forward[i] += h
        backward[i] -= h
        columns.append((function(forward) - function(backward)) / (forward[i] - backward[i]))
    return np.stack(columns, axis=-1)


STEPS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)


def derivative_error(function, jacobian, point, blocks=(slice(None),), steps=STEPS):
    """Largest relative difference between a Jacobian and central differences, at the best step.

    It is taken column by column in each block of rows, relative to the largest entry there (absolute if all are zero).
    """
    jacobian = np.asarray(jacobian)
    differences = np.array([central_differences(function, point, step) for step in steps])
    errors = []
    for rows in blocks:
        largest = np.abs(jacobian[rows]).max(axis=0)
        scale = np.where(largest > 0, largest, 1.0)
        sweep = np.abs(differences[:, rows] - jacobian[rows]).max(axis=1) / scale
        errors.append(sweep.min(axis=0).max())
    return float(np.max(errors))
