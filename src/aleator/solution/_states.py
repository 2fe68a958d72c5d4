"""`States`: the states of all realisations of a simultaneous program, as they are at its answer."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from aleator._core.given import refusal
from aleator._core.shown import Drawn


@final
@dataclass(frozen=True)
class States(Drawn):
    """The states of some realisations over time.

    - `times`: the points of the mesh, s, shape (points,);
    - `germs`: the germ points of the realisations, shape (realisations, variables);
    - `values`: by the name of the state, shape (realisations, points, ...).
    """

    times: Float[np.ndarray, " points"]
    germs: Float[np.ndarray, "realisations variables"]
    values: Mapping[str, Float[np.ndarray, "realisations points ..."]]

    def __getitem__(self, name: str) -> Float[np.ndarray, "realisations points ..."]:
        return known(self.values, name)

    @property
    def fractions(self) -> Float[np.ndarray, " points"]:
        """The points of the mesh as fractions of the duration."""
        return (self.times - self.times[0]) / (self.times[-1] - self.times[0])

    def __str__(self) -> str:
        count, span = len(self.germs), f"from t = {self.times[0]:.4g} to {self.times[-1]:.4g} s"
        return f"{count} realisation{'s'[: count > 1]} at {len(self.times)} points {span}: {ranges(self.values)}"


def known(values: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    """One of some arrays. Raises `ProblemError` if there is none of this name."""
    if name not in values:
        raise refusal("name", f"one of {list(values)}", name)
    return values[name]


def ranges(values: Mapping[str, np.ndarray]) -> str:
    """From where to where each of some arrays goes."""
    return ", ".join(f"{name} from {np.min(one):.4g} to {np.max(one):.4g}" for name, one in values.items())
