"""Controllers: from what is measured and what is planned to the inputs of the actuators."""

import abc
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple, final

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.border import a_name
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module, stored_numbers, transparent
from aleator.trajectories import AbstractSignal, as_array


class Plan(NamedTuple):
    """What a controller knows beside its measurements, at one instant.

    - `states`: those of the plan, a named tuple; `inputs`: all inputs of the plan, by name;
    - `rates`: `rates(z, inputs)`, the rates of the states by the model at the means of its distributions;
    - `to`: the inputs that the controller commands; `schedule`: its gains at this instant, if it has a schedule.
    """

    states: Any
    inputs: dict[str, Array]
    rates: Callable[[Any, dict[str, Array]], Any]
    to: tuple[str, ...]
    schedule: Any = None

    def errors(self, measured: Any) -> dict[str, Array]:
        """The plan minus what is measured, by name."""
        return {name: getattr(self.states, name) - value for name, value in measured._asdict().items()}

    @property
    def flat(self) -> tuple[Float[Array, " actuators"], Callable[[Array], dict[str, Array]]]:
        """The planned inputs of the actuators side by side, and such numbers by name."""
        numbers, named = ravel_pytree(tuple(self.inputs[name] for name in self.to))
        return numbers, lambda vector: dict(zip(self.to, named(vector), strict=True))


class AbstractController(Module):
    """A control law of one's own, whose numbers may be distributions or decisions: see `command`.

    `needs_all`: whether it needs measurements of all states.
    """

    needs_all: ClassVar[bool] = False

    @abc.abstractmethod
    def command(self, t: Any, measured: Any, plan: Plan) -> Mapping[str, Any]:
        """The commanded inputs, by name, such as `{"u": plan.inputs["u"] + self.k * (plan.states.x - measured.x)}`.

        - `measured`: the measured states with their noise, a named tuple; `plan`: see `Plan`.
        """

    def schedule(self, model: Any, inputs: dict[str, AbstractSignal], to: tuple[str, ...]) -> AbstractSignal | None:
        """Gains over time, which follow from the model at the means and the inputs of the plan; None for none."""
        del model, inputs, to
        return None


@final
@transparent("numbers")
class Proportional(AbstractController):
    """Inputs of the plan, and gains times the errors of what is measured: proportional and derivative (PD) control."""

    numbers: Any

    @override
    def command(self, t: Any, measured: Any, plan: Plan) -> Mapping[str, Any]:
        planned, named = plan.flat
        errors = {name: jnp.ravel(one) for name, one in plan.errors(measured).items()}
        if isinstance(self.numbers, dict):
            errors = {name: errors[name] for name in self.numbers}
            blocks = [_block(f"gains['{n}']", self.numbers[n], len(planned), len(one)) for n, one in errors.items()]
            matrix = jnp.concatenate(blocks, axis=1)
        else:
            n = sum(map(len, errors.values()))
            matrix = jnp.asarray(as_array(self.numbers))
            if matrix.shape not in ((len(planned), n), (n,) if len(planned) == 1 else ()):
                raise _shape_refused("gains", f"({len(planned)}, {n}), actuators by measured numbers", matrix)
        return named(planned + jnp.reshape(matrix, (len(planned), -1)) @ jnp.concatenate([*errors.values()]))


def _block(who: str, numbers: Any, actuators: int, n: int) -> Float[Array, "actuators n"]:
    """The gains of one measured state: one number for all, one for each of as many actuators, or a matrix."""
    gains = jnp.asarray(as_array(numbers))
    if gains.shape == (actuators, n):
        return gains
    if n == actuators and gains.shape in ((), (n,)):
        return jnp.diag(jnp.broadcast_to(gains, (n,)))
    if (actuators == 1 and gains.shape in ((), (n,))) or (n == 1 and gains.shape == (actuators,)):
        return jnp.reshape(jnp.broadcast_to(gains, (max(n, actuators),)), (actuators, n))
    raise _shape_refused(who, f"({actuators}, {n}), actuators by numbers of this state", gains)


def _shape_refused(who: str, expected: str, gains: Array) -> ProblemError:
    return ProblemError(f"Feedback: {who}: expected the shape {expected}; received {gains.shape}.")


def proportional(gains: Any) -> Proportional:
    """Numbers, or numbers by measured state, as a controller. Raises `ProblemError` for anything else."""
    if isinstance(gains, Mapping):
        names = [a_name("Feedback: a name in gains", name) for name in gains]
        return Proportional({name: stored_numbers(f"Feedback: gains['{name}']", gains[name]) for name in names})
    return Proportional(stored_numbers("Feedback: gains", gains))


@final
class ComputedTorque(AbstractController):
    """See `computed_torque`."""

    position: Any
    velocity: Any

    needs_all: ClassVar[bool] = True

    @override
    def command(self, t: Any, measured: Any, plan: Plan) -> Mapping[str, Any]:
        if len(measured) != 2:
            raise ProblemError(
                "computed_torque: expected two measured states, positions and velocities, such as of=('q', 'v'); "
                f"received {measured._fields}."
            )
        planned, named = plan.flat
        at, place = ravel_pytree(plan.states)
        here = jnp.concatenate([jnp.ravel(one) for one in type(plan.states)(**measured._asdict())])
        speed = measured._fields[1]

        def acceleration(z: Array, u: Array) -> Array:
            rates = plan.rates(place(z), plan.inputs | named(u))
            return jnp.ravel(getattr(rates, speed))

        def seen(z: Array) -> tuple[Array, Array]:
            along = jax.vmap(lambda d: jax.jvp(lambda u: acceleration(z, u), (planned,), (d,)), out_axes=(None, -1))
            return along(jnp.eye(planned.size))

        (planned_rate, rate), (_, effect) = jax.vmap(seen)(jnp.stack([at, here]))
        first, second = (jnp.ravel(one) for one in plan.errors(measured).values())
        wanted = planned_rate + as_array(self.position) * first + as_array(self.velocity) * second
        if effect.shape[0] != effect.shape[1]:
            raise ProblemError(
                f"computed_torque: expected as many actuators as velocities, {effect.shape[0]}; received "
                f"{effect.shape[1]}. Use gains or al.lqr."
            )
        return named(planned + jnp.linalg.solve(effect, wanted - rate))


def computed_torque(position: Any, velocity: Any) -> ComputedTorque:
    """Computed torque (feedback linearisation): inputs for which the model at the means would accelerate as planned,
    and by `position` times the error of the positions and `velocity` times that of the velocities more.

    - `position`, `velocity`: one gain or one for each degree of freedom, 1/s² and 1/s.

    Two states are measured, `of=(positions, velocities)`, all that the system has; accelerations are affine in the
    commanded inputs, of which there are as many. The inputs are exact where the model at the means is.
    """
    what = "computed_torque: gains of the"
    return ComputedTorque(stored_numbers(f"{what} position", position), stored_numbers(f"{what} velocity", velocity))
