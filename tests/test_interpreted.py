"""Equations computed by NumPy, against the same compiled by JAX."""

import jax
import jax.numpy as jnp
import numpy as np

from aleator._core.dependence import interpreted
from compiling import compiled, programs_listed

MATRIX = np.arange(1.0, 13.0).reshape(3, 4)
POINT = np.array([0.3, -1.7, 0.9, 2.4])

FUNCTIONS = {
    "functions of one number": lambda x: [
        one(x) for one in (jnp.sin, jnp.exp, jnp.log1p, jnp.abs, jnp.sign, jnp.floor, jnp.tanh, jnp.arctan, jnp.cbrt)
    ],
    "powers": lambda x: [x**3, x**-2, jnp.abs(x) ** 1.5, jax.lax.rsqrt(x**2), jnp.sqrt(x), jnp.square(x)],
    "two numbers": lambda x: [x - x[::-1], x / x[0], jnp.arctan2(x, x[::-1]), jnp.maximum(x, 0.5), jnp.clip(x, -1, 1)],
    "choices": lambda x: [jnp.where(x > 0, x, -2 * x), jax.lax.select_n(jnp.arange(4) % 3, x, -x, 2 * x)],
    "logic": lambda x: [((x > 0) & ~(x < 1) | (x == x[0]) ^ (x != x[0])).astype(float), jnp.isfinite(1 / (x - x[0]))],
    "products": lambda x: [MATRIX @ x, x @ x, jnp.einsum("ij,j,kj->jik", MATRIX, x, MATRIX), jnp.outer(x, x)],
    "a batch of products": lambda x: [jnp.einsum("bij,bjk->bik", *2 * [x.reshape(1, 2, 2) * jnp.ones((3, 1, 1))])],
    "sums": lambda x: [
        x.sum(),
        (MATRIX * x[None]).sum(axis=1),
        jnp.cumsum(x),
        jax.lax.cumsum(x, reverse=True),
        x.max(),
    ],
    "places": lambda x: [x[::2], x.reshape(2, 2).T, jnp.concatenate([x, x]), jnp.stack([x, x]), jnp.split(x, 2)[1]],
    "chosen places": lambda x: [x[np.array([2, 0])], x[jnp.array([[1], [3], [3]])], x[jnp.arange(5) % 4]],
    "places that change": lambda x: [
        x.at[1].set(5.0),
        x.at[jnp.array([1, 1])].add(x[:2]),
        jnp.zeros((2, 4)).at[1].set(x),
    ],
    "whole numbers": lambda x: [jnp.arange(4) * 3 - 1, x.astype(int), (jnp.arange(4) / 2) * x, jnp.array(x > 0)],
    "nested functions": lambda x: [jax.jit(lambda y: jnp.sin(y) * x)(x), jax.nn.relu(x), jnp.linalg.norm(x)],
    "many at once": lambda x: [jax.vmap(lambda y: y[np.array([1, 0])] * jnp.sum(x))(x.reshape(2, 2))],
}


def by_numpy(function):
    closed = jax.make_jaxpr(function)(POINT)
    return interpreted(closed.jaxpr, closed.consts, [POINT])


def test_what_numpy_computes_is_what_a_program_would_and_nothing_is_compiled():
    expected = compiled(lambda x: {name: function(x) for name, function in FUNCTIONS.items()})(POINT)
    with programs_listed() as programs:
        found = {name: by_numpy(function) for name, function in FUNCTIONS.items()}
    assert programs == []
    for name, values in found.items():
        for one, other in zip(values, expected[name], strict=True):
            assert one.dtype == other.dtype, name
            np.testing.assert_allclose(one, other, rtol=1e-14, atol=1e-14, err_msg=name)


OTHERS = {
    "a loop": lambda x: jax.lax.fori_loop(0, 4, lambda _, y: y + jnp.sin(y), x),
    "a division that rounds": lambda x: jax.lax.div(jnp.arange(4) - 7, 2),
    "places outside": lambda x: x.at[jnp.array([7])].get(mode="fill", fill_value=-1.0),
}


def test_what_numpy_has_no_function_for_is_computed_too():
    expected = compiled(lambda x: {name: function(x) for name, function in OTHERS.items()})(POINT)
    for name, function in OTHERS.items():
        np.testing.assert_allclose(by_numpy(function)[0], expected[name], rtol=1e-13, err_msg=name)
