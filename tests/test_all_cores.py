"""Work on all cores: the results of a plain loop, in order, and what fails does so in its turn."""

import threading
from itertools import count, islice

import jax.numpy as jnp
import numpy as np
import pytest

from aleator._core import beside as cores
from aleator._core.beside import CORES, beside, in_order
from aleator._core.compilation import Compiled


def test_results_come_in_the_order_of_their_items_whoever_is_first():
    waiting = [threading.Event() for _ in range(5)]
    waiting[-1].set()

    def last_first(item):
        if CORES > 1:  # alone, a thread that waits for its successor waits for ever
            waiting[min(item + 1, len(waiting) - 1) if item % CORES != CORES - 1 else -1].wait(10)
        waiting[item].set()
        return item**2

    assert list(in_order(last_first, range(5))) == [0, 1, 4, 9, 16]


def test_no_more_items_are_taken_than_are_worked_on():
    taken = []

    def items():
        for item in count():
            taken.append(item)
            yield item

    assert list(islice(in_order(lambda item: item, items()), 3)) == [0, 1, 2]
    assert len(taken) <= 3 + CORES


def test_what_fails_does_so_after_what_comes_before_it():
    def work(item):
        if item == 3:
            raise ValueError("three")
        return item

    found = in_order(work, range(7))
    assert list(islice(found, 3)) == [0, 1, 2]
    with pytest.raises(ValueError, match="three"):
        next(found)


def test_what_is_begun_beside_gives_its_result_and_its_error_when_asked():
    assert beside(sum, [1, 2, 3])() == 6
    with pytest.raises(ZeroDivisionError):
        beside(lambda: 1 / 0)()


def test_one_core_does_it_all_by_itself(monkeypatch):
    monkeypatch.setattr(cores, "CORES", 1)
    here = threading.current_thread()
    assert list(in_order(lambda item: (item, threading.current_thread() is here), range(3))) == [
        (0, True),
        (1, True),
        (2, True),
    ]


def test_what_is_prepared_is_not_compiled_again():
    compiled = Compiled(lambda scale, x: scale["by"] * x)
    compiled.prepare({"by": jnp.asarray(1.0)}, jnp.zeros(3))
    assert compiled.compilations == 1
    np.testing.assert_array_equal(compiled({"by": jnp.asarray(2.0)}, jnp.arange(3.0)), [0.0, 2.0, 4.0])
    assert compiled.compilations == 1
    compiled({"by": jnp.asarray(2.0)}, jnp.arange(4.0))
    assert compiled.compilations == 2
