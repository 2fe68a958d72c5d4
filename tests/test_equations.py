"""Texts of equations differ where functions or their derivatives do; no rule is traced that tells nothing."""

import functools

import jax
import jax.numpy as jnp
import pytest

from aleator._core.equations import equations_text
from aleator.dynamics._instantaneous import at_each_instant


def text_of(function):
    return equations_text(jax.make_jaxpr(lambda x: function(x))(1.0))


def square(rule):
    function = jax.custom_jvp(lambda x: x**2)
    function.defjvp(rule)
    return function


def slope(factor):
    return lambda primals, tangents: (primals[0] ** 2, factor * 2 * primals[0] * tangents[0])


def root(factor):
    """The square root of two, whose derivative is `factor` times as large as it is."""
    return lambda x: jax.lax.custom_root(
        lambda y: y * y - 2.0 * x, 1.0, lambda f, y: jnp.sqrt(2.0), lambda g, b: factor * b / g(1.0)
    )


RULES = {
    "a closure": lambda factor: square(slope(factor)),
    "a partial of JAX's": lambda factor: square(functools.partial(jax.jvp, square(slope(factor)))),
    "a tree's partial of JAX's": lambda factor: square(jax.tree_util.Partial(jax.jvp, square(slope(factor)))),
    "under the name of JAX's": lambda factor: square(functools.wraps(jax.jvp)(slope(factor))),
    "in JAX's own rule": root,
}


@pytest.mark.parametrize("make", RULES.values(), ids=list(RULES))
def test_functions_that_are_differentiated_otherwise_have_other_texts(make):
    assert text_of(make(1.0)) == text_of(make(1.0))
    assert text_of(make(1.0)) != text_of(make(3.0))


def test_the_rule_of_functions_of_one_instant_is_not_traced_for_its_text():
    traces = []

    def function(gain, row):
        traces.append(1)
        return gain * jnp.sin(row)

    closed = jax.make_jaxpr(lambda gain, rows: at_each_instant(function, gain, rows))(2.0, jnp.ones((5, 2)))
    before = len(traces)
    assert "custom_jvp_call" in str(equations_text(closed))
    assert len(traces) == before > 0


def test_a_rule_of_a_users_inside_a_function_of_one_instant_is_told_apart():
    def text(factor):
        function = square(slope(factor))
        return equations_text(
            jax.make_jaxpr(lambda gain, rows: at_each_instant(lambda g, row: g * function(row), gain, rows))(
                2.0, jnp.ones((5, 2))
            )
        )

    assert text(1.0) == text(1.0)
    assert text(1.0) != text(3.0)
