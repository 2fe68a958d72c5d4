"""`Motion`: the state of a mechanical system at one instant, with accelerations and torques."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float


class Motion(NamedTuple):
    """A mechanical system at one instant, from forward, inverse or hybrid dynamics.

    - `t`: s; `q`, `q_dot`, `q_ddot`: coordinates and their time derivatives, shape (coordinates,);
    - `v`, `v_dot`: generalised velocities and their time derivatives, shape (speeds,); `q_dot = H(q) v`;
    - `torque`: the actuators' torques, shape (actuators,);
    - `multipliers`: Lagrange multipliers `λ` of the constraints, shape (constraints,).
    """

    t: Any
    q: Float[Array, " coordinates"]
    q_dot: Float[Array, " coordinates"]
    q_ddot: Float[Array, " coordinates"]
    v: Float[Array, " speeds"]
    v_dot: Float[Array, " speeds"]
    torque: Float[Array, " actuators"]
    multipliers: Float[Array, " constraints"] = np.zeros(0)  # type: ignore[assignment]
