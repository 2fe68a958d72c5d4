"""Equations that JAX can differentiate in one direction alone, or not at all."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from zoo import optimum


def root_by_newton(square):
    """The square root by Newton's method, until it is found: of no number below 1e-3, so that it always is."""
    square = jnp.maximum(square, 1e-3)

    def is_far(root):
        return jnp.abs(root**2 - square) > 1e-14 * square

    # The condition is computed once: JAX would compute it twice in a step, and rounding may differ.
    def step(carried):
        root = (carried[0] + square / carried[0]) / 2
        return root, is_far(root)

    first = jnp.maximum(square, 1.0)
    return jax.lax.while_loop(lambda carried: carried[1], step, (first, is_far(first)))[0]


@jax.custom_vjp
def sine_backward(x):
    return jnp.sin(x)


sine_backward.defvjp(lambda x: (jnp.sin(x), x), lambda x, slope: (slope * jnp.cos(x),))


def sine_called(x, **options):
    return jax.pure_callback(np.sin, jax.ShapeDtypeStruct(x.shape, x.dtype), x, **options)


class Decay(al.System):
    """Decay at a rate that is a function of a number."""

    states = ("x",)
    number: al.Number
    rate: Callable[[jax.Array], jax.Array]

    def rhs(self, t, z):
        return (-self.rate(self.number * (1 + z.x)) * z.x,)

    def initial(self):
        return {"x": 1.0}

    def outputs(self, t, z):
        return {"x": z.x}


def problem(rate):
    return al.Problem(
        Decay(al.Uniform(al.Decision(1.0, 0.1, 4.0), half_width=0.05), rate),
        grid=al.Grid(1.0, 10),
        minimize=al.value("number.mean"),
        subject_to=[al.terminal("x").mean <= 0.25],
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "way", [al.Sequential(), al.Simultaneous(al.schemes.GaussLegendre(2))], ids=["shooting", "collocation"]
)
def test_a_loop_that_ends_when_a_root_is_found_has_the_answer_of_the_root_itself(way):
    looped, known = (optimum(problem(rate), transcription=way) for rate in (root_by_newton, jnp.sqrt))
    assert looped.objective == pytest.approx(known.objective, rel=1e-9)


@pytest.mark.parametrize(
    ("rate", "message"),
    [
        (sine_backward, "The equations use 'jax.custom_vjp'.* write the rule by 'jax.custom_jvp'"),
        (sine_called, "The equations use 'jax.pure_callback'.* give it a 'vmap_method'"),
        (lambda x: sine_called(x, vmap_method="sequential"), "has no derivatives: give them by 'jax.custom_jvp'"),
    ],
    ids=["backward alone", "one at a time", "no derivatives"],
)
def test_equations_without_derivatives_are_refused_with_what_to_write_instead(rate, message):
    with pytest.raises(al.ProblemError, match=message):
        al.solve(problem(rate))
