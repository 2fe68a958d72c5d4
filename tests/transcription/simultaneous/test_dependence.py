"""Which variables blocks depend on: against their derivatives at generic points."""

import jax
import jax.numpy as jnp
import numpy as np

from aleator._core.dependence import dependence
from aleator.transcription.simultaneous._blocks import Family
from compiling import compiled, programs_listed

MATRIX = np.arange(1.0, 10.0).reshape(3, 3)


@jax.custom_jvp
def rounded(x):
    return jnp.round(x)


@rounded.defjvp
def _(primals, tangents):
    return rounded(*primals), tangents[0]


def iterated(x):
    """A root by a loop, whose equations are not followed."""
    return jax.lax.fori_loop(0, 5, lambda _, y: y - (y**2 - x[0]) / (2 * y), 1.0 + x[1] * 0)


# Blocks of four variables each; whether the pattern is as narrow as it can be.
BLOCKS = {
    "one number each": (lambda x: jnp.stack([x[0], x[1] * x[2], jnp.sin(x[3]), x[0] + 2.0]), True),
    "a quotient": (lambda x: jnp.stack([x[0] / x[1], x[2] / 3.0, 1.0 / x[3]]), True),
    "powers": (lambda x: jnp.stack([x[0] ** 2, x[1] ** 1.5, x[2] ** x[3]]), True),
    "products of matrices": (lambda x: MATRIX @ x[:3] * x[3], True),
    "a product of two": (lambda x: jnp.outer(x[:2], x[2:]) @ x[:2], True),
    "a batch of products": (lambda x: jnp.einsum("ij,ik->ijk", x.reshape(2, 2), x.reshape(2, 2)).ravel(), True),
    "sums": (lambda x: jnp.stack([jnp.sum(x[:2] ** 2), jnp.cumsum(x)[1], jnp.mean(x[2:])]), True),
    "places": (lambda x: jnp.concatenate([x[::-1], jnp.pad(x[1:2], (1, 2)), jnp.roll(x, 1)]), True),
    "chosen places": (lambda x: x[np.array([2, 0])] * x[np.array([0, 3])], False),
    "a place that is added to": (lambda x: jnp.sin(x).at[-1].add(x[0] * x[1]), True),
    "places that are set": (lambda x: jnp.zeros((2, 3)).at[0, 1:].set(x[2:]).at[1].add(x[0] ** 2).ravel(), True),
    "one place twice": (lambda x: jnp.zeros(3).at[jnp.array([1, 1])].add(x[:2] ** 2), False),
    "counted places": (lambda x: x[jnp.arange(1, 4) % 4] + x[3 - jnp.arange(3)], False),
    "a norm": (lambda x: jnp.linalg.norm(x[:2])[None], True),
    "a choice": (lambda x: jnp.where(x[0] > 0, x[1] ** 2, x[2])[None], False),
    "the larger": (lambda x: jnp.maximum(x[:2], x[2:]), False),
    "a rule of its own": (lambda x: rounded(x[:2]) * x[2:], False),
    "a loop": (lambda x: jnp.stack([iterated(x), x[2]]), False),
    "a nested function": (lambda x: jax.jit(lambda y: y[:2] * jnp.exp(y[2:]))(x), True),
    "a solution": (lambda x: jnp.linalg.solve(jnp.eye(2) + x[:2, None] * x[None, 1:3], x[2:]), False),
    "numbers that are counted": (lambda x: jnp.sum(x > 0)[None] * x[:1], True),
    "no numbers beside": (lambda x: jnp.concatenate([x[:0], x, jnp.zeros(0)]), True),
    "a sum of nothing": (lambda x: x + jnp.sum(x[:0] * x[0]) + jnp.cumsum(x[:0] * x[1]).sum(), False),
    "complex numbers": (lambda x: jnp.real((x[0] + 1j * x[1]) ** 2)[None], False),
    "a complex magnitude": (lambda x: jnp.abs(x[:1] + 1j * x[1:2]) * x[2:3], True),
    "short numbers": (lambda x: (x.astype(jnp.bfloat16) ** 2).astype(float), True),
}


def bends(block):
    return jax.jacfwd(jax.jacfwd(block))


@compiled
def derivatives(points):
    """First and second derivatives of all blocks at some points."""
    return {name: [jax.vmap(one(block))(points) for one in (jax.jacfwd, bends)] for name, (block, _) in BLOCKS.items()}


def test_no_derivative_lies_outside_of_the_pattern():
    every = derivatives(np.random.default_rng(7).uniform(0.5, 2.0, (3, 4)))
    for name, (block, is_narrow) in BLOCKS.items():
        first, second = (np.abs(np.asarray(one)) > 1e-12 for one in every[name])
        first, second = first.any(axis=0), second.any(axis=(0, 1))
        found = dependence(block, (), [np.zeros(4)])
        assert found.first.shape == first.shape, name
        assert not (first & ~found.first).any(), name
        assert not (second & ~found.second).any(), name
        if is_narrow:
            assert np.array_equal(found.first, first), name
            assert np.array_equal(found.second, second), name


def test_data_are_no_variables_and_variables_stand_side_by_side():
    found = dependence(lambda d, s, o: d["a"] * s[0] * o, ({"a": np.ones(2)},), [np.zeros(1), np.zeros(2)])
    assert np.array_equal(found.first, [[True, True, False], [True, False, True]])
    assert np.array_equal(found.second, [[False, True, True], [True, False, False], [True, False, False]])


def test_many_variables_are_followed_one_by_one():
    found = dependence(lambda x: x[7] * x[300:301] + jnp.sum(x[:3]), (), [jax.ShapeDtypeStruct((1000,), float)])
    assert np.array_equal(np.flatnonzero(found.first), [0, 1, 2, 7, 300])
    assert np.array_equal(np.argwhere(found.second), [[7, 300], [300, 7]])


# --- Affine blocks ---------------------------------------------------------------------------------------------------

AFFINE = {
    "a product with a matrix": (lambda d, x: MATRIX @ x[:3] + d, True),
    "factors that data decide": (lambda d, x: jnp.where(d > 1, x[0], jnp.sin(d) * x[1:2] / 3.0), True),
    "a place": (lambda d, x: x.at[1].add(x[0]) - 2.0, True),
    "nothing": (lambda d, x: d, True),
    "a product": (lambda d, x: x[:1] * x[1], False),
    "a choice": (lambda d, x: jnp.where(x > 0, x, 0.0), False),
    "a count": (lambda d, x: jnp.sum(x > 0)[None] * d, False),
    "a sign": (lambda d, x: jnp.sign(x), False),
    "rounded numbers": (lambda d, x: jnp.floor(x), False),
    "a rule of its own": (lambda d, x: rounded(x), False),
    "a loop": (lambda d, x: jax.lax.fori_loop(0, 2, lambda _, y: 2 * y, x), False),
}


def test_blocks_are_affine_whose_derivatives_are_the_same_everywhere():
    for name, (block, is_affine) in AFFINE.items():
        assert (dependence(block, (np.ones(1),), [np.ones(4)]).affine is not None) is is_affine, name


def test_affine_blocks_have_rows_and_slopes_without_a_program():
    """Of `offset + factor a + b u`: slopes are exact whatever is added to them."""
    outer, inner = np.array([[1e9, 3e-7], [-2.0, 5.0], [0.0, 0.0]]), np.array([[0.25], [4.0]])

    def block(data, factor, shared, own):
        return jnp.stack([data[0] + data[1] * shared[0] + factor[0] * own[1], own[0] + 1.0])

    family = Family(block, np.arange(1), np.arange(1, 13).reshape(3, 2, 2), outer, inner)
    depends = family.dependence
    with programs_listed() as programs:
        rows, slopes = family.affine(depends.affine, np.flatnonzero(depends.first))
    assert programs == []
    np.testing.assert_array_equal(rows, np.broadcast_to([[[one, 1.0]] for one in outer[:, 0]], (3, 2, 2)))
    for i, j in np.ndindex(3, 2):
        np.testing.assert_allclose(slopes[i, j], [outer[i, 1], inner[j, 0], 1.0], rtol=1e-14)
