"""Readings of code: equal where nothing has changed, different where something has, doubtful where none can tell."""

import functools
import itertools
import math
import random
from collections import deque
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import aleator as al
from aleator._core.code import read_code

NUMBERS = {"gain": 1.0, "list": [1.0, {"deep": np.array([1.0, 2.0])}]}


class Slotted:
    __slots__ = ("gain",)

    def __init__(self):
        self.gain = 1.0

    def force(self):
        return self.gain

    @property
    def stiffness(self):
        return NUMBERS["gain"]

    @staticmethod
    def still():
        return NUMBERS["gain"]

    @classmethod
    def of_class(cls):
        return NUMBERS["gain"]


class Listed(list):
    def total(self):
        return NUMBERS["gain"] * sum(self)


class Pair(NamedTuple):
    first: float

    def scaled(self):
        return NUMBERS["gain"] * self.first


class Labelled(float):
    def scaled(self):
        return NUMBERS["gain"] * self


SLOTTED, LISTED, PAIR, LABELLED = Slotted(), Listed([1.0]), Pair(1.0), Labelled(1.0)


def helper():
    return NUMBERS["gain"]


def decorated(function):
    @functools.wraps(function)
    def wrapper(*arguments):
        return function(*arguments)

    return wrapper


def mutual(n):
    return other(n - 1) if n else NUMBERS["gain"]


def other(n):
    return mutual(n)


def renamed(x):
    return jnp.sin(x) + math.pi


FUNCTIONS = {
    "a dict": lambda: NUMBERS["gain"],
    "through a function": lambda: helper(),
    "a partial": functools.partial(lambda numbers: numbers["gain"], NUMBERS),
    "a wrapper": decorated(helper),
    "a vectorised function": jax.vmap(lambda x: x * NUMBERS["gain"]),
    "a rule of differentiation": jax.custom_jvp(lambda x: x * NUMBERS["gain"]),
    "an inner function": lambda: sorted([1.0, 2.0], key=lambda one: NUMBERS["gain"] * one),
    "a comprehension": lambda: [NUMBERS["gain"] for _ in range(2)],
    "functions that call each other": mutual,
    "a property": lambda: SLOTTED.stiffness,
    "a static method": Slotted.still,
    "a class method": Slotted.of_class,
    "a bound method": SLOTTED.of_class,
    "a list of its own kind": lambda: LISTED.total(),
    "a named tuple": lambda: PAIR.scaled(),
    "a number of its own kind": lambda: LABELLED.scaled(),
    "a class of NumPy that calls": np.vectorize(helper),
}


@pytest.mark.parametrize("function", FUNCTIONS.values(), ids=FUNCTIONS)
def test_a_number_is_followed_wherever_it_is_read(monkeypatch, function):
    before = read_code([function])
    assert before == read_code([function])
    assert not before.doubts
    monkeypatch.setitem(NUMBERS, "gain", 2.0)
    assert read_code([function]) != before


def test_what_stands_deep_inside_is_read_too(monkeypatch):
    before = read_code([FUNCTIONS["a dict"]])
    NUMBERS["list"][1]["deep"][1] = 3.0
    assert read_code([FUNCTIONS["a dict"]]) != before
    NUMBERS["list"][1]["deep"][1] = 2.0
    assert read_code([FUNCTIONS["a dict"]]) == before
    monkeypatch.setattr(SLOTTED, "gain", 2.0)
    slots = read_code([SLOTTED.force])
    monkeypatch.setattr(SLOTTED, "gain", -0.0)
    signed = read_code([SLOTTED.force])
    monkeypatch.setattr(SLOTTED, "gain", 0.0)
    assert slots != signed != read_code([SLOTTED.force])


def test_a_library_object_is_read_by_what_it_holds():
    spline = CubicSpline(np.arange(4.0), np.arange(4.0))
    before = read_code([spline])
    assert not before.doubts
    assert read_code([spline]) == before
    spline.c[0, 0] = 1.0
    assert read_code([spline]) != before


def test_code_of_data_is_read_while_their_numbers_are_not(monkeypatch):
    before = read_code({"pair": Pair(1.0)})
    assert read_code({"pair": Pair(2.0)}) == before
    monkeypatch.setitem(NUMBERS, "gain", 2.0)
    assert read_code({"pair": Pair(1.0)}) != before


def test_numbers_that_are_structure_are_no_code_either():
    assert read_code(al.Grid(1.0, 10)) == read_code(al.Grid(1.0, 10).finer(3))


def test_names_of_libraries_that_stand_for_something_else_are_noticed(monkeypatch):
    before = read_code([renamed])
    assert not before.doubts
    monkeypatch.setattr(jnp, "sin", jnp.cos)
    assert read_code([renamed]) != before


def test_numbers_of_the_tree_are_data_and_no_code():
    assert read_code({"a": 1.0, "b": np.arange(3.0)}) == read_code({"a": 2.0, "b": np.arange(4.0)})


ITERATOR, GENERATOR, JITTED = itertools.count(), np.random.default_rng(0), jax.jit(lambda: NUMBERS["gain"])
REMEMBERED = functools.lru_cache(helper)
UFUNC = np.frompyfunc(lambda x: x, 1, 1)

DOUBTS = {
    "an iterator": lambda: next(ITERATOR),
    "a generator of random numbers": lambda: GENERATOR.normal(),
    "random numbers of NumPy": lambda: np.random.normal(),  # noqa: NPY002
    "random numbers": lambda: random.random(),
    "a compiled function": lambda: JITTED(),
    "a function that remembers": lambda: REMEMBERED(),
    "Python code inside NumPy": lambda: UFUNC(1.0),
    "an evaluated text": lambda: eval("NUMBERS['gain']"),
    "a name that is put together": lambda: getattr(SLOTTED, "ga" + "in"),
    "all globals": lambda: globals()["NUMBERS"],
    "what is typed": lambda: input(),
}


@pytest.mark.parametrize("function", DOUBTS.values(), ids=DOUBTS)
def test_what_cannot_be_read_is_a_doubt(function):
    assert read_code([function]).doubts


def test_endless_structures_are_read_to_an_end():
    chain = deque()
    chain.append(chain)
    NUMBERS_OF_MANY = [[i] for i in range(30_000)]
    assert read_code([lambda: chain]).reads
    assert read_code([lambda: NUMBERS_OF_MANY]).doubts


gain = 1.0


class Gained:
    """Has an attribute of a global's name."""

    gain = 2.0

    def own(self):
        return self.gain

    def both(self):
        return self.gain + gain


@pytest.mark.parametrize(("method", "follows"), [(Gained.own, False), (Gained.both, True)])
def test_an_attribute_of_the_name_of_a_global_is_not_the_global(monkeypatch, method, follows):
    before = read_code(method)
    monkeypatch.setitem(globals(), "gain", 5.0)
    assert (read_code(method).reads != before.reads) is follows
