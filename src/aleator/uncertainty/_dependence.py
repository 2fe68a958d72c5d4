"""How a correlated distribution depends on the germ: by the Cholesky factor of its group's Gaussian copula."""

from collections.abc import Mapping, Sequence
from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from aleator._core.errors import ProblemError
from aleator._core.module import Module


@final
class Dependence(Module):
    """A member's place in a group of correlated distributions.

    The group has one standard normal germ variable for each member. Member `index` is a function of the normal variable
    `factor[index] @ germs`, where `factor` is the Cholesky factor of the normals' correlation matrix. So it depends on
    its own germ variable and on those of the members before it.
    """

    group: str = eqx.field(static=True)
    members: tuple[str, ...] = eqx.field(static=True)
    index: int = eqx.field(static=True)
    factor: Float[np.ndarray, "members members"] | Float[Array, "members members"]

    @property
    def germ_names(self) -> tuple[str, ...]:
        """The germ variables on which the member depends."""
        return tuple(f"{self.group}.{member}" for member in self.members[: self.index + 1])

    def normal(self, germs: Sequence[Float[Array, ""]]) -> Float[Array, ""]:
        """The member's standard normal variable at the values of its germ variables."""
        return jnp.asarray(self.factor)[self.index, : self.index + 1] @ jnp.stack(germs)

    def __str__(self) -> str:
        return f"'{self.members[self.index]}' of the correlated group '{self.group}'"


def check_groups(dependences: Mapping[str, Dependence | None]) -> None:
    """Refuse two groups of one name, and a member placed twice; `dependences` are keyed by the distributions' names."""
    groups: dict[str, Dependence] = {}
    placed: dict[str, str] = {}
    for place, dependence in dependences.items():
        if dependence is None:
            continue
        if not _is_one_group(dependence, groups.setdefault(dependence.group, dependence)):
            raise ProblemError(
                f"'{dependence.group}' names two groups of correlated distributions. Give `name` to one of them: "
                "correlated(..., name=...)."
            )
        own = dependence.germ_names[-1]
        if own in placed:
            raise ProblemError(
                f"{dependence} is placed twice, at '{placed[own]}' and at '{place}'. Make both one number with "
                '`.shared("name")`, or make two groups with two names: correlated(..., name=...).'
            )
        placed[own] = place
    for dependence in groups.values():
        for germ in (f"{dependence.group}.{member}" for member in dependence.members):
            if germ in dependences and dependences[germ] is None:
                raise ProblemError(
                    f"'{germ}' names a germ variable of a correlated group and an independent distribution. "
                    "Give the group another name: correlated(..., name=...)."
                )


def _is_one_group(first: Dependence, second: Dependence) -> bool:
    if first.members != second.members:
        return False
    if any(isinstance(one.factor, Tracer) for one in (first, second)):
        return True  # compared before compilation
    return np.array_equal(np.asarray(first.factor), np.asarray(second.factor))
