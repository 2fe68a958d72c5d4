"""`Costates` and `Switching`: what a push of a state, or of an input, would change at a solution."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from aleator._core.shown import Drawn
from aleator.solution._states import known, ranges


@final
@dataclass(frozen=True)
class Costates(Drawn):
    """The derivative of the optimal objective by each state at each node: by an extra push of it at that instant.

    Their sign is that of the objective: a negative costate says that more of the state would lower it. A realisation is
    pushed by itself, so that the sum over realisations belongs to a push of all of them.

    - `times`: the nodes of the mesh, s, shape (nodes,);
    - `germs`: the germ points of the realisations, shape (realisations, variables);
    - `values`: by the name of the state, shape (realisations, nodes, ...).
    """

    times: Float[np.ndarray, " nodes"]
    germs: Float[np.ndarray, "realisations variables"]
    values: Mapping[str, Float[np.ndarray, "realisations nodes ..."]]

    def __getitem__(self, name: str) -> Float[np.ndarray, "realisations nodes ..."]:
        return known(self.values, name)

    def __str__(self) -> str:
        return f"costates of {ranges(self.values)}, {len(self.germs)} realisations at {len(self.times)} nodes"


@final
@dataclass(frozen=True)
class Switching(Drawn):
    """The derivative of the Hamiltonian by each input: by how much the objective changes for each unit of the input and
    each second that it is raised there. Where it is positive, an input at its lower bound is optimal; where it is
    negative, one at its upper bound; a control that is between its bounds makes it zero.

    The Hamiltonian holds the costates times the rates, and the integrands in the objective and in limits, summed over
    realisations. Limits on outputs at instants are not in it, and it is empty where inputs are uncertain or a statistic
    is integrated over time.

    - `times`: where the scheme asks for rates, s, shape (points,); where inputs jump, nodes may be there twice, as seen
      from before and from after;
    - `values`: by the name of the input, shape (points, ...).
    """

    times: Float[np.ndarray, " points"]
    values: Mapping[str, Float[np.ndarray, "points ..."]]

    def __getitem__(self, name: str) -> Float[np.ndarray, "points ..."]:
        return known(self.values, name)

    def __str__(self) -> str:
        return f"switching function of {ranges(self.values)}, at {len(self.times)} points"
