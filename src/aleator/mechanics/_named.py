"""`AbstractNamed`: mechanical systems whose coordinates, velocities, actuators and constraints a class names."""

from collections.abc import Sequence
from typing import ClassVar

from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.mechanics._mechanical import AbstractMechanical


class AbstractNamed(AbstractMechanical):
    """A mechanical system with names declared in its class: `names = ("shoulder", "elbow")`.

    `velocity_names` and `actuator_names` may be declared too, where there is not one for each coordinate. Coordinates
    that are bound by equations are declared by `constraint_names` and `constraint(q)`:

        constraint_names = ("height",)

        def constraint(self, q):
            return (self.crank * jnp.sin(q[0]) - self.rod * jnp.sin(q[1]),)
    """

    names: ClassVar[tuple[str, ...]]
    velocity_names: ClassVar[Sequence[str] | None] = None
    actuator_names: ClassVar[Sequence[str] | None] = None
    constraint_names: ClassVar[Sequence[str]] = ()

    def __check_init__(self):
        if bool(self.constraint_names) != (type(self).constraint is not AbstractMechanical.constraint):
            raise ProblemError(
                f"{type(self).__name__}: expected constraint_names and constraint(q) together, one name for each "
                f"equation; received {'no constraint(q)' if self.constraint_names else 'no constraint_names'}."
            )
        for field in ("names", "velocity_names", "actuator_names", "constraint_names"):
            if isinstance(given := getattr(self, field, None), str):
                raise ProblemError(
                    f"{type(self).__name__}.{field}: expected names in a tuple; received the text {given!r}. A single "
                    f"name needs a comma: ({given!r},)."
                )

    @property
    @override
    def coordinates(self) -> tuple[str, ...]:
        return tuple(self.names)

    @property
    @override
    def speeds(self) -> tuple[str, ...]:
        given = self.velocity_names
        return tuple(f"{name}_rate" for name in self.names) if given is None else tuple(given)

    @property
    @override
    def actuators(self) -> tuple[str, ...]:
        given = self.actuator_names
        return tuple(f"{name.removesuffix('_rate')}_torque" for name in self.speeds) if given is None else tuple(given)

    @property
    @override
    def constraints(self) -> tuple[str, ...]:
        return tuple(self.constraint_names)
