"""Readings of code: equal where nothing has changed, different where something has, doubtful where none can tell."""

import ctypes
import enum
import functools
import importlib
import itertools
import logging
import math
import operator
import random
import sys
import types
from collections import defaultdict, deque
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy
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


COMPILED, REMEMBERING = jax.jit(lambda: NUMBERS["gain"]), functools.lru_cache(helper)

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
    "a compiled function": lambda: COMPILED(),
    "a function that remembers": lambda: REMEMBERING(),
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


ITERATOR, GENERATOR = itertools.count(), np.random.default_rng(0)
POINTER = ctypes.pointer(ctypes.c_double(1.0))
UFUNC = np.frompyfunc(lambda x: x, 1, 1)

DOUBTS = {
    "an iterator": lambda: next(ITERATOR),
    "a generator of random numbers": lambda: GENERATOR.normal(),
    "random numbers of NumPy": lambda: np.random.normal(),  # noqa: NPY002
    "random numbers": lambda: random.random(),
    "Python code inside NumPy": lambda: UFUNC(1.0),
    "an evaluated text": lambda: eval("NUMBERS['gain']"),
    "a name that is put together": lambda: getattr(SLOTTED, "ga" + "in"),
    "all globals": lambda: globals()["NUMBERS"],
    "what is typed": lambda: input(),
    "all modules": lambda: sys.modules[__name__].NUMBERS,
    "the names of a caller": lambda: sys._getframe().f_globals["NUMBERS"],
    "the globals of a function": lambda: helper.__globals__["NUMBERS"],
    "a module by its name": lambda: importlib.import_module(__name__).NUMBERS,
    "an attribute by its name": lambda: operator.attrgetter("gain")(SLOTTED),
    "all names of a library": lambda: np.__dict__["pi"],
    "random numbers of a library under another name": lambda: (lambda it: it.random.rand())(np),
    "an address": lambda: POINTER[0],
    "a file that a library reads": lambda: np.load("table.npy"),
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


class Sheet:
    """Has fields and methods of the names of functions in libraries."""

    def outputs(self):
        xp = jnp
        columns = [one.read_csv for one in self.columns]
        return xp.sqrt(self.load) * np.pi + self.input.sum() + np.sum(self.open) + jnp.sin(self.load).max(), columns

    def inside(self):
        import numpy as inside
        import scipy.linalg as algebra
        from numpy import cos as cosine

        return [inside.sin(self.load), algebra.norm(self.memmap), cosine(self.loadtxt)]


@pytest.mark.parametrize("method", [Sheet.outputs, Sheet.inside])
def test_an_attribute_of_the_name_of_a_librarys_function_is_no_doubt(method):
    reading = read_code(method)
    assert not reading.doubts
    assert not any("load" in place.name for place, _ in reading.reads)


@pytest.mark.parametrize(
    ("method", "owner", "name"),
    [
        (Sheet.outputs, jnp, "sqrt"),
        (Sheet.outputs, np, "sum"),
        (Sheet.inside, np, "sin"),
        (Sheet.inside, np, "cos"),
        (Sheet.inside, scipy.linalg, "norm"),
    ],
)
def test_attributes_are_followed_from_globals_imports_and_their_other_names(monkeypatch, method, owner, name):
    before = read_code(method)
    monkeypatch.setattr(owner, name, len)
    assert read_code(method) != before


MODULE = types.ModuleType("measured")
MODULE.value, MODULE.deep = 1.0, types.ModuleType("measured.deep")  # type: ignore[attr-defined]
MODULE.deep.value = 1.0  # type: ignore[attr-defined]


def of_a_module(it):
    return it.value


def in_a_loop():
    for number in range(2):
        if number:
            return it.value
        it = MODULE  # noqa: F841
    return None


def of_a_closure():
    it = MODULE
    return lambda: it.value


def exchanged():
    import math as first

    second, it = first, MODULE
    return second.pi, it.value


def imported_deeply():
    import measured.deep as inside  # type: ignore[import-not-found]

    return inside.value


FROM_MODULES = {
    "two names at once": exchanged,
    "an attribute": lambda: MODULE.value,
    "another name": lambda: [it := MODULE, it.value],
    "an argument": lambda: of_a_module(MODULE),
    "a default": lambda it=MODULE: it.value,
    "one of two": lambda yes=True: (math if yes else MODULE).value,
    "a closure": of_a_closure(),
    "a loop": in_a_loop,
    "a list": functools.partial(lambda modules: modules[0].value, [MODULE]),
    "its names": lambda: MODULE.__dict__["value"],
}


@pytest.mark.parametrize("function", FROM_MODULES.values(), ids=FROM_MODULES)
def test_a_value_in_a_module_is_followed_wherever_the_module_goes(monkeypatch, function):
    before = read_code([function])
    assert before == read_code([function])
    assert not before.doubts
    monkeypatch.setattr(MODULE, "value", 2.0)
    assert read_code([function]) != before


def test_a_module_imported_by_its_whole_name_is_the_inner_one(monkeypatch):
    monkeypatch.setitem(sys.modules, "measured", MODULE)
    monkeypatch.setitem(sys.modules, "measured.deep", MODULE.deep)
    before = read_code([imported_deeply])
    assert not before.doubts
    monkeypatch.setattr(MODULE, "value", 2.0)
    assert read_code([imported_deeply]) == before
    monkeypatch.setattr(MODULE.deep, "value", 2.0)
    assert read_code([imported_deeply]) != before


def test_using_a_flag_does_not_change_it():
    def function():
        return Way.UP

    before = read_code([function])
    assert ~Way.UP | Way.DOWN
    assert read_code([function]) == before
    assert not before.doubts


def test_of_a_module_only_what_is_named_is_read(monkeypatch):
    before = read_code([FROM_MODULES["an attribute"]])
    monkeypatch.setattr(MODULE.deep, "value", 2.0)
    assert read_code([FROM_MODULES["an attribute"]]) == before


def test_a_part_of_a_library_that_is_loaded_at_its_first_use_reads_the_same_before_and_after(monkeypatch):
    monkeypatch.delitem(vars(al), "tolerance_analysis", raising=False)
    before = read_code([analysed])
    al.tolerance_analysis  # noqa: B018 -- loads it
    assert read_code([analysed]) == before
    assert any(place.name == "al.tolerance_analysis" for place, _ in before.reads)


def analysed(model):
    return al.tolerance_analysis(model, "gap", lower=0.0)


class Noted(np.ndarray):
    pass


class Scaled(dict):
    pass


class Mixed(float):
    pass


class Load(enum.Enum):
    HEAVY = [1.0]  # noqa: RUF012


class Way(enum.Flag):
    UP, DOWN = 1, 2


MASKED = np.ma.array([2.0, 3.0], mask=[False, True])
NOTED, SCALED, MIXED = np.zeros(2).view(Noted), Scaled(), Mixed(1.0)
NOTED.factor = SCALED.factor = MIXED.factor = 1.0  # type: ignore[attr-defined]
OF_C, RECORDS = (ctypes.c_double * 2)(1.0, 2.0), np.array([(1.0, [1.0])], dtype=[("a", float), ("b", object)])
DEFAULTS = defaultdict(lambda: 1.0)

CHANGES = {
    "the mask": (MASKED, lambda: setattr(MASKED, "mask", [True, False])),
    "masked data": (MASKED, lambda: MASKED.data.__setitem__(1, 7.0)),
    "the value in place of what is masked": (MASKED, lambda: setattr(MASKED, "fill_value", 5.0)),
    "an attribute of an array": (NOTED, lambda: setattr(NOTED, "factor", 2.0)),
    "an attribute of a dict": (SCALED, lambda: setattr(SCALED, "factor", 2.0)),
    "an attribute of a number": (MIXED, lambda: setattr(MIXED, "factor", 2.0)),
    "memory of C": (OF_C, lambda: OF_C.__setitem__(1, 3.0)),
    "an object in a record": (RECORDS, lambda: RECORDS["b"][0].append(2.0)),
    "what is made for a missing key": (DEFAULTS, lambda: setattr(DEFAULTS, "default_factory", lambda: 2.0)),
    "the value of a member": (Load, lambda: Load.HEAVY.value.append(2.0)),
}


@pytest.mark.parametrize(("it", "change"), CHANGES.values(), ids=CHANGES)
def test_what_an_object_adds_to_its_kind_is_read(it, change):
    def function():
        return it

    before = read_code([function])
    assert before == read_code([function])
    assert not before.doubts
    change()
    assert read_code([function]) != before


def test_using_a_masked_array_does_not_change_it():
    it = np.ma.array([1.0, 2.0], mask=[True, False])

    def function():
        return it

    before = read_code([function])
    assert it.sum() + it.filled().sum() > 0.0
    assert read_code([function]) == before


def test_a_function_that_remembers_is_a_doubt_once_what_it_reads_has_changed():
    numbers = {"gain": 1.0}
    inner = jax.jit(lambda: numbers["gain"])
    assert not read_code([lambda: inner()]).doubts
    numbers["gain"] = 2.0
    assert read_code([lambda: inner()]).doubts
    numbers["gain"] = 1.0
    assert not read_code([lambda: inner()]).doubts


def test_what_is_only_logged_is_no_doubt():
    logger = logging.getLogger(__name__)
    assert not read_code([lambda: (logger.info("solved"), logging.info("solved"))]).doubts
