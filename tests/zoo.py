"""Small models whose answers are known in closed form, shared by all tests.

Numbers, limits and distributions of a model are data: problems that differ in nothing else share their programs, which
a worker compiles once. A change of anything else (the family of a distribution, a functional, the number of steps, the
order) costs a second of a processor for `Bar`, three for `Gain`, six for `Oscillator`: take the first that will do.
`optimum` finds an optimum without the checks of an answer, for tests that look at nothing else.
"""

import inspect
import os
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator import nlp
from aleator._core.arrays import jax_array
from aleator.transcription import DEFAULT, AbstractTranscribed, AbstractTranscription, transcribe
from aleator.uncertainty import realise

# --- Without time ----------------------------------------------------------------------------------------------------


class Bar(al.AlgebraicSystem):
    """A bar of some width under an uncertain load."""

    width: al.Number
    load: al.Number

    def outputs(self):
        return {"stress": self.load / self.width, "mass": self.width}


STRESS, MASS = al.output("stress"), al.output("mass")


def bar_problem(load: float = 1.0, highest: float = 10.0, stress: float = 0.5, **options: Any) -> al.Problem:
    """The lightest bar that is strong enough, no wider than `highest`.

    `width = (load + 3 * HALF_WIDTH / √3) / stress`, since the stress is `load / width`.
    """
    model = Bar(al.Decision(4.0, 0.1, highest), al.Uniform(load, half_width=HALF_WIDTH))
    strong = (STRESS.mean + 3 * STRESS.std <= stress).named("stress")
    return al.Problem(model, minimize=MASS.mean, subject_to=[strong], **options)


class Wave(al.AlgebraicSystem):
    """A wave that no polynomial of low order follows."""

    width: al.Number
    off: al.Number

    def outputs(self):
        return {"wave": jnp.sin(8.0 * self.off) * self.width, "width": self.width}


class Valleys(al.AlgebraicSystem):
    """A depth with a minimum on either side; the deeper one is at a negative place."""

    place: al.Number
    off: al.Number

    def outputs(self):
        return {"depth": (self.place**2 - 1.0) ** 2 + 0.2 * self.place + self.off}


class TwoBasins(al.AlgebraicSystem):
    """A loss with minima 1 at `a = 1` and 3 at `a = 5`, which meet at `a = 3.25`."""

    a: al.Number

    def outputs(self):
        return {"loss": jnp.minimum((self.a - 1) ** 2 + 1, (self.a - 5) ** 2 + 3), "a": self.a}


def valleys_problem() -> al.Problem:
    return al.Problem(Valleys(al.Decision(0.5, -2.0, 2.0), al.Normal(0.0, 0.1)), minimize=al.output("depth").mean)


class Hardening(al.AlgebraicSystem):
    """A spring that hardens: `k x + x³ = a`, with the deflection `x` under a force `a` as an unknown."""

    unknowns = ("x",)

    a: al.Number = al.parameter("N")
    k: al.Number = 1.0

    def guess(self):
        return {"x": 0.5}

    def residual(self, rho):
        return (self.k * rho.x + rho.x**3 - self.a,)

    def outputs(self, rho):
        return {"x": rho.x, "force": self.k * rho.x}


# --- Over time -------------------------------------------------------------------------------------------------------


class Gain(al.System):
    """No dynamics: the response `gain * theta + shift`, and how far gain and shift are from 3 and 1."""

    states = ("nothing",)

    gain: al.Number
    theta: al.Number
    shift: al.Number = 0.0

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


class Decay(al.System):
    """`x' = -rate x` from `x(0) = start`."""

    states = ("x",)

    rate: al.Number
    start: al.Number = 1.0

    def rhs(self, t, z):
        return (-self.rate * z.x,)

    def outputs(self, t, z):
        return {"x": z.x}

    def initial(self):
        return {"x": self.start}


class Oscillator(al.System):
    """A mass on a spring and a damper, pushed by a force."""

    states = ("x", "v")

    m: al.Number = al.parameter("kg", positive=True)
    c: al.Number = al.parameter("N s/m")
    k: al.Number = al.parameter("N/m", positive=True)
    x0: al.Number = 0.0

    def rhs(self, t, z, force):
        return z.v, (force - self.c * z.v - self.k * z.x) / self.m

    def outputs(self, t, z, force):
        return {"x": z.x, "v": z.v, "spring": self.k * z.x}

    def initial(self):
        return {"x": self.x0}


def sine(amplitude: float = 1.0, frequency: float = 3.0) -> al.Tabulated:
    times = np.linspace(0.0, 5.0, 501)
    return al.Tabulated(times, amplitude * np.sin(frequency * times))


def oscillator_problem(**options: Any) -> al.Problem:
    """A mass near resonance whose spring is uncertain: the weakest damper that holds it within limits."""
    defaults: dict[str, Any] = {
        "grid": al.Grid(4.0, 80),
        "inputs": {"force": sine()},
        "minimize": 0.1 * al.value("c") + al.rms("v").mean,
        "subject_to": [al.path("x").within(-0.14, 0.14, sigmas=2.0)],
        "expansion": al.Expansion(order=3),
    }
    system = Oscillator(m=1.0, c=al.Decision(0.5, 0.05, 8.0), k=al.Uniform(10.0, half_width=2.0))
    return al.Problem(system, **(defaults | options))


class Block(al.System):
    """A block of uncertain mass, pushed by a force, from rest to rest: `x(1) = 1` with the least effort.

    Without limits the force is `12 (1/2 - t)` and the effort, the integral of its square, 12.
    """

    states = ("x", "v")

    mass: al.Number = 1.0

    def rhs(self, t, z, force):
        return z.v, force / self.mass

    def outputs(self, t, z, force):
        return {"x": z.x, "v": z.v, "effort": force**2}


class Launched(Block):
    """The block from any place at any speed."""

    place: al.Number = 0.0
    speed: al.Number = 0.0

    def initial(self):
        return {"x": self.place, "v": self.speed}


def block_problem(mass: Any = 1.0, steps: int = 10, **options: Any) -> al.Problem:
    x, v = al.terminal("x"), al.terminal("v")
    defaults: dict[str, Any] = {
        "grid": al.Grid(1.0, steps),
        "inputs": {"force": al.Control(0.0, -20.0, 20.0)},
        "minimize": al.integral("effort").mean,
        "subject_to": [x.mean.equals(1.0), v.mean.equals(0.0)],
    }
    return al.Problem(Block(mass), **(defaults | options))


G = 9.81


class Shot(al.System):
    """A body thrown upwards from some height, with drag `c |v| v`."""

    states = ("x", "y", "vx", "vy")
    speed: al.Number = 20.0
    angle: al.Number = 0.7
    height: al.Number = 0.0
    c: al.Number = 0.0
    events: ClassVar = {
        "ground": al.Event(lambda self, t, z: z.y, direction=-1),
        "top": al.Event(lambda self, t, z: z.vy, direction=-1),
    }

    def rhs(self, t, z):
        drag = self.c * jnp.sqrt(z.vx**2 + z.vy**2)
        return z.vx, z.vy, -drag * z.vx, -G - drag * z.vy

    def initial(self):
        return {"y": self.height, "vx": self.speed * jnp.cos(self.angle), "vy": self.speed * jnp.sin(self.angle)}

    def outputs(self, t, z):
        return {"x": z.x, "y": z.y, "vx": z.vx}


class Tank(al.System):
    """A weak acid is fed, leaves with the flow, and reacts at a rate that its dissociated part sets.

    `hydrogen` follows from the equilibrium `constant = h² / (acid - h)`, the positive root of two.
    """

    states = ("acid",)
    algebraic = ("hydrogen",)

    constant: al.Number = 0.1
    rate: al.Number = 1.0

    def rhs(self, t, z, feed):
        return (feed - 0.5 * z.acid - self.rate * z.hydrogen * z.acid,)

    def residual(self, t, z):
        return (z.hydrogen**2 - self.constant * (z.acid - z.hydrogen),)

    def algebraic_guess(self, t, z):
        return {"hydrogen": jnp.sqrt(self.constant * jnp.abs(z.acid))}

    def outputs(self, t, z, feed):
        miss = (z.hydrogen - 0.2) ** 2 + 0.01 * feed**2
        return {"acid": z.acid, "hydrogen": z.hydrogen, "feed": feed, "miss": miss}

    def initial(self):
        return {"acid": 0.2}


# --- Bodies ----------------------------------------------------------------------------------------------------------


class Pendulum(al.Lagrangian):
    """A point mass on a massless rod, by its energies; the angle is from the vertical."""

    names = ("angle",)

    mass: al.Number = 1.0
    length: al.Number = 1.0
    gravity: al.Number = 9.81

    def kinetic_energy(self, q, v):
        return 0.5 * self.mass * self.length**2 * v[0] ** 2

    def potential_energy(self, q):
        return -self.mass * self.gravity * self.length * jnp.cos(q[0])


class Crane(al.Lagrangian):
    """A trolley that carries a load on a rope: its place, and the angle of the rope from the vertical."""

    names = ("trolley", "sway")
    actuator_names = ("trolley_force",)

    mass: al.Number = 10.0
    payload: al.Number = 5.0
    rope: al.Number = 2.0

    def kinetic_energy(self, q, v):
        across, up = v[0] + self.rope * v[1] * jnp.cos(q[1]), self.rope * v[1] * jnp.sin(q[1])
        return 0.5 * self.mass * v[0] ** 2 + 0.5 * self.payload * (across**2 + up**2)

    def potential_energy(self, q):
        return -self.payload * 9.81 * self.rope * jnp.cos(q[1])


class Cart(al.Mechanical):
    """A cart of some mass in the wind, which may be a signal."""

    names = ("x",)
    mass: al.Number = al.parameter("kg", positive=True, default=2.0)
    wind: al.Number = 0.0

    def mass_matrix(self, q):
        return self.mass * jnp.eye(1)

    def load(self, q, v):
        return jnp.reshape(self.wind, (1,))

    def outputs(self, motion):
        return {"effort": jnp.asarray(self.wind) ** 2}


# --- Helpers ---------------------------------------------------------------------------------------------------------

CASES = int(os.environ.get("ALEATOR_TEST_CASES", "1"))


def cases(values: Iterable[Any], first: int = CASES) -> list[Any]:
    """The parameters of a family, such as its seeds: the first of them by default, the others if slow."""
    rows = (value if isinstance(value, tuple) else (value,) for value in values)
    return [pytest.param(*row, marks=[pytest.mark.slow] * (i >= first)) for i, row in enumerate(rows)]


def histories(problem, germs):
    """The outputs of some realisations at the initial decisions."""
    start = jax_array(problem.placements.vector("initial"))
    every = jax.vmap(lambda germ: realise(problem.simulation, germ, start).history())
    return jax.tree.map(np.asarray, jax.jit(every)(np.asarray(germs, dtype=float)))


def algebraic(outputs: Callable[..., dict[str, Any]]) -> type[Any]:
    """The algebraic systems whose outputs are a function of their numbers, which have the names of its arguments."""
    arguments = inspect.signature(outputs).parameters
    own: dict[str, Any] = {"__annotations__": dict.fromkeys(arguments, al.Number)}
    own |= {name: one.default for name, one in arguments.items() if one.default is not one.empty}
    own |= {"outputs": lambda self: outputs(*(getattr(self, name) for name in arguments))}
    return type(al.AlgebraicSystem)("Algebraic", (al.AlgebraicSystem,), own)


class Optimum(NamedTuple):
    """The end of a search: decisions by name, the objective, the solver's outcome, and the program it solved."""

    decisions: dict[str, Any]
    objective: float
    outcome: nlp.Outcome
    transcribed: AbstractTranscribed


def optimum(
    problem: al.Problem, solver: nlp.AbstractSolver | None = None, transcription: AbstractTranscription = DEFAULT
) -> Optimum:
    """Transcribe and optimise, and nothing else: no finer grid, no fresh systems, no limits between instants.

    Raises `AssertionError` unless the solver's own conditions of optimality hold.
    """
    transcribed = transcribe(problem, transcription)
    outcome = (solver or transcription.solver).solve(transcribed.program)
    assert outcome.status is nlp.Status.SOLVED, outcome.message
    meaning = transcribed.at(outcome.point)
    return Optimum(problem.placements.named(meaning.decisions), meaning.objective, outcome, transcribed)


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

    It is taken column by column in each block of rows, relative to the largest entry there (absolute if all are zero
    but for rounding).
    """
    jacobian = np.asarray(jacobian)
    differences = np.array([central_differences(function, point, step) for step in steps])
    errors = []
    for rows in blocks:
        largest = np.abs(jacobian[rows]).max(axis=0)
        scale = np.where(largest > 1e-13, largest, 1.0)
        sweep = np.abs(differences[:, rows] - jacobian[rows]).max(axis=1) / scale
        errors.append(sweep.min(axis=0).max())
    return float(np.max(errors))
