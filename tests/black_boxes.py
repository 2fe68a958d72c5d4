"""Functions for black boxes, in a module that other processes can import: plain NumPy and SciPy."""

import os

import numpy as np
from scipy.integrate import solve_ivp

GRAVITY = 9.81  # m/s²
RELEASE = 1.0  # rad
DURATION = 6.0  # s


def smooth(at):
    """A number and a vector, smooth in x and z."""
    return {"y": float(np.exp(at["x"]) * at["z"]), "v": np.array([at["x"], at["z"] ** 2, 1.0])}


def crash(at):
    """The same, ending its process where x is large."""
    if at["x"] > 0.9:
        os._exit(3)
    return smooth(at)


def stiff(at):
    """The same, failing in the corner where both inputs are large."""
    if at["x"] > 0.7 and at["z"] > 2.5:
        raise ValueError("no convergence\nafter 20 iterations")
    return smooth(at)


def hanging(at):
    """The same, never ending where x is large."""
    while at["x"] > 0.9:
        pass
    return smooth(at)


def rod(at):
    """A uniform rod hinged at its end, released at rest: the period of its first swing (s) and its last angle (rad).

    Its moment of inertia about the hinge is m l²/3, its weight acts at l/2, and the hinge is viscous.
    """
    mass, length, damping = at["mass"], at["length"], at["damping"]
    inertia = mass * length**2 / 3

    def rates(t, state):
        angle, speed = state
        return speed, -(mass * GRAVITY * length / 2 * np.sin(angle) + damping * speed) / inertia

    def hanging_down(t, state):
        return state[0]

    found = solve_ivp(rates, (0.0, DURATION), (RELEASE, 0.0), "DOP853", events=hanging_down, rtol=1e-11, atol=1e-12)
    passages = found.t_events[0]
    return {"period": passages[2] - passages[0], "angle": found.y[0, -1]}
