"""Distributions held at their means: a deterministic model that retains its distributions."""

from collections.abc import Callable
from typing import Any, ClassVar, final

import jax

from aleator._core.arrays import Pytree
from aleator._core.leaves import AbstractLeaf, is_leaf
from aleator.uncertainty._distribution import AbstractDistribution


@final
class AtMean(AbstractLeaf):
    """A distribution held at its mean: `deterministic` replaces each distribution by one."""

    UNCERTAIN: ClassVar[bool] = False

    distribution: AbstractDistribution

    @property
    def shared_name(self) -> str | None:  # type: ignore[override]
        """The name under which the distribution is shared."""
        return self.distribution.shared_name

    @property
    def shape(self) -> tuple[int, ...]:
        """That of the distribution."""
        return self.distribution.shape

    def lowest(self) -> float | None:
        """That of the distribution, which evidence samples again."""
        return self.distribution.lowest()

    def highest(self) -> float | None:
        """That of the distribution, which evidence samples again."""
        return self.distribution.highest()


def free(leaf: Any) -> Any:
    """The distribution behind a leaf that holds it at its mean; any other leaf as it is."""
    return leaf.distribution if isinstance(leaf, AtMean) else leaf


def at_means(model: Pytree) -> Pytree:
    """The model with every distribution held at its mean: no germ is left."""
    return _replace(model, AbstractDistribution, AtMean)  # type: ignore[arg-type]


def uncertain_again(model: Pytree) -> Pytree:
    """The inverse of `at_means`."""
    return _replace(model, AtMean, lambda leaf: leaf.distribution)


def _replace(model: Pytree, kind: type, change: Callable[[Any], Any]) -> Pytree:
    return jax.tree.map(
        lambda leaf: change(leaf) if isinstance(leaf, kind) else leaf,
        model,
        is_leaf=is_leaf,
    )
