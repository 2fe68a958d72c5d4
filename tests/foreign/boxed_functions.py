"""Black boxes for tests: their reference, functions that count and fail, and refusals."""

import queue
from pathlib import Path

import numpy as np
import pytest

import aleator as al
import black_boxes as boxes

TWO = {"x": al.Uniform.bounds(-1.0, 1.0), "z": al.Uniform.bounds(1.0, 3.0)}
ORDER = al.Expansion(order=3)
# Fresh points of a called function, beside the 30 of that order.
FRESH = 2


def directly(function=boxes.smooth, expansion=ORDER):
    return al.expand(function, TWO, expansion, traced=False)


def assert_same(expanded, other):
    for name, coefficients in other.coefficients.items():
        np.testing.assert_array_equal(expanded.coefficients[name], coefficients)
        np.testing.assert_array_equal(expanded.samples[name], other.samples[name])
    np.testing.assert_array_equal(expanded.collocation.points, other.collocation.points)


class Counted:
    """A function that counts its calls, from several threads too: in a queue, which cannot be read as its code."""

    def __init__(self, function=boxes.smooth):
        self.function, self._queue = function, queue.SimpleQueue()

    @property
    def calls(self):
        return self._queue.qsize()

    def __call__(self, at):
        self._queue.put(None)
        return self.function(at)


def until(path, failing):
    """`failing` until there is a file, and `boxes.smooth` from then on."""
    path = str(path)
    return lambda at: boxes.smooth(at) if Path(path).exists() else failing(at)


def refused(box, model=TWO, kind=al.SimulationError, expansion=ORDER):
    with pytest.raises(kind) as caught:
        al.expand(box, model, expansion)
    return str(caught.value)


def odd(value):
    """A function that returns something else at one sample."""
    return lambda at: value if at["x"] > 0.9 else boxes.smooth(at)
