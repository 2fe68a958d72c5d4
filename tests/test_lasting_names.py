"""A name for a program is one for all processes: it differs wherever what is computed may; in doubt there is none."""

import ctypes
import enum
import functools
import logging
import operator
from collections import defaultdict
from fractions import Fraction
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aleator._core.arrays import numbers_to_arrays
from aleator._core.lasting import DoubtError, lasting_name, lasting_parts


class Part(eqx.Module):
    number: Any
    fixed: Any = eqx.field(static=True, default=None)


class Colour(enum.Enum):
    RED, GREEN = 1, 2


class Generator:
    def __init__(self):
        self.state = np.random.default_rng(0)


def named(*arguments):
    return lasting_name(numbers_to_arrays, arguments)


def scaling(factor):
    return lambda x: factor * x


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (1, True),
        (0.0, -0.0),
        (1.0, 1),
        ("a", b"a"),
        ((1, (2, 3)), ((1, 2), 3)),
        ([1], (1,)),
        ({"a": 1}, {"b": 1}),
        (Fraction(1, 2), Fraction(1, 3)),
        (frozenset("ab"), frozenset("ac")),
        (scaling(2.0), scaling(3.0)),
        (scaling(2), scaling(2.0)),
        (scaling(jnp.ones(2)), scaling(jnp.zeros(2))),
        (lambda x: x + 1, lambda x: x + 2),
        (lambda x: x + 1, lambda x: x - 1),
        (lambda x, by=1: by * x, lambda x, by=2: by * x),
        (lambda x: jnp.sin(x), lambda x: jnp.cos(x)),
    ],
)
@pytest.mark.parametrize("place", [lambda it: it, lambda it: Part(1.0, it), lambda it: Part((it,))])
def test_what_differs_has_another_name(one, other, place):
    names = [named(place(it)) for it in (one, other)]
    assert None not in names
    assert names[0] != names[1]


@pytest.mark.parametrize("place", [lambda it: it, lambda it: Part(1.0, it)])
def test_members_of_an_enumeration_have_names_of_their_own_or_none(place):
    names = [named(place(it)) for it in Colour]
    assert names[0] is None or names[0] != names[1]


@pytest.mark.parametrize(
    "it",
    [np.random.default_rng(0), object(), Generator(), lambda: np.random.default_rng(), print],
)
@pytest.mark.parametrize("place", [lambda it: it, lambda it: Part(1.0, it)])
def test_what_has_no_lasting_text_is_a_doubt(it, place):
    assert named(place(it)) is None


def test_numbers_of_traced_arrays_are_no_part_of_a_name():
    assert named(Part(jnp.zeros(2), "a")) == named(Part(jnp.ones(2), "a"))


def test_shapes_and_kinds_of_arrays_are_part_of_a_name():
    arrays = [jnp.zeros(2), jnp.zeros(3), jnp.zeros(2, dtype=int), jnp.zeros(()), np.zeros(2), 0.0]
    names = [named(Part(one)) for one in arrays]
    assert None not in names
    assert len(set(names)) == len(names)


def test_equal_structures_made_anew_have_one_name():
    assert named(Part(jnp.zeros(2), scaling(2.0))) == named(Part(jnp.zeros(2), scaling(2.0)))


def test_settings_of_jax_are_part_of_a_name():
    before = named(1)
    with jax.default_matmul_precision("float32"):
        assert named(1) != before
    assert named(1) == before


def test_another_function_has_another_name_and_a_users_has_none():
    assert lasting_name(lasting_name, (1,)) != lasting_name(numbers_to_arrays, (1,))
    assert lasting_name(scaling, (1,)) is None


def test_objects_read_twice_are_told_by_which_they_are():
    first, second = [1.0], [1.0]
    assert named(Part(1.0, (first, second, first))) == named(Part(1.0, (second, first, second)))

    def reads(chosen):
        return lambda: (first, second, chosen)

    assert named(reads(first)) != named(reads(second))


class Pair(NamedTuple):
    first: float


class Wide(float):
    pass


def constant(it):
    """Code that reads an object made anew, as another process would make it."""
    return lambda: it


def masked(mask):
    return np.ma.array([1.0, 2.0], mask=mask)


KEPT = {
    "a member": lambda which: list(Colour)[which],
    "a named tuple": lambda which: Pair(float(which)),
    "a number of its own kind": lambda which: Wide(which),
    "a compiled function": lambda which: jax.jit(scaling(float(which))),
    "a compiled function with another setting": lambda which: jax.jit(lambda x, y: x, static_argnums=which),
    "a vectorised function": lambda which: jax.vmap(scaling(float(which))),
    "a gradient": lambda which: jax.grad(scaling(float(which))),
    "a function that remembers": lambda which: functools.lru_cache(scaling(float(which))),
    "a masked array": lambda which: masked([which, 0]),
    "an object of C": lambda which: (ctypes.c_double * 1)(which),
    "a default": lambda which: defaultdict(constant(which)),
    "a getter of items": operator.itemgetter,
    "a logger": lambda which: logging.getLogger(str(which)),
}


@pytest.mark.parametrize("made", KEPT.values(), ids=KEPT)
def test_what_code_reads_has_a_lasting_name_by_what_it_holds(made):
    names = [named(Part(1.0, constant(made(which)))) for which in (0, 1, 0)]
    assert None not in names
    assert names[0] == names[2] != names[1]


def random_helper():
    return np.random.normal()  # noqa: NPY002


MARK = object()


@pytest.mark.parametrize(
    ("it", "said"),
    [
        (random_helper, "the global 'np.random' that random_helper reads"),
        (constant(MARK), "the closure variable 'it' that constant.<locals>.<lambda> reads"),
        (constant(iter([1])), "the closure variable 'it' that constant.<locals>.<lambda> reads"),
        (Generator(), "Generator"),
        ((masked([True, False]),), "numpy.ma.*MaskedArray"),
    ],
)
def test_a_doubt_says_what_it_is_about(it, said):
    with pytest.raises(DoubtError, match=said):
        lasting_parts({"model": it})
