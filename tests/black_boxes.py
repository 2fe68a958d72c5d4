"""Functions for black boxes, in a module that other processes can import: plain NumPy and SciPy."""

import os

import numpy as np


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
