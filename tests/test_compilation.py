"""Executables: one for each structure of the arguments, and the same numbers however they travel."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aleator._core.compilation import Compiled, Use


def _results(tree, kind, x):
    products = {name: part * x.sum() for name, part in tree["parts"].items()}
    return products, jnp.arange(3) + tree["shift"], (x.sum() > 0, jnp.zeros((0, 2))), kind


TREE = {"parts": {"a": jnp.arange(6.0).reshape(3, 2), "b": jnp.asarray(2.5)}, "shift": jnp.asarray(4)}


def _expected(x):
    return (
        {"a": np.arange(6.0).reshape(3, 2) * x.sum(), "b": 2.5 * x.sum()},
        np.arange(3) + 4,
        (x.sum() > 0, np.zeros((0, 2))),
        7,
    )


def test_bound_functions_give_every_array_its_shape_kind_and_numbers_back():
    x = np.array([0.5, -3.0])
    found = Compiled(_results).bound(TREE, jnp.asarray(7))(x)
    leaves, expected = jax.tree.leaves(found), jax.tree.leaves(_expected(x))
    assert jax.tree.structure(found) == jax.tree.structure(_expected(x))
    for one, other in zip(leaves, expected, strict=True):
        assert isinstance(one, np.ndarray)
        assert one.dtype == np.asarray(other).dtype
        np.testing.assert_array_equal(one, other)
    with pytest.raises(ValueError, match="read-only"):
        found[0]["a"][0, 0] = 1.0


def test_bound_functions_of_other_numbers_share_an_executable_and_those_of_another_structure_do_not():
    compiled = Compiled(_results)
    first = compiled.bound(TREE, jnp.asarray(7))(np.ones(2))
    second = compiled.bound(jax.tree.map(lambda leaf: 2 * leaf, TREE), jnp.asarray(7))(np.ones(2))
    assert compiled.compilations == 1
    np.testing.assert_array_equal(second[0]["a"], 2 * first[0]["a"])
    compiled.bound(TREE | {"parts": {"a": TREE["parts"]["a"]}}, jnp.asarray(7))(np.ones(2))
    assert compiled.compilations == 2


def test_what_a_check_of_a_library_stops_gives_no_number_in_the_right_shape():
    def checked(tree, x):
        return eqx.error_if(x, x.sum() > 1, "too large") * tree["parts"]["b"], jnp.arange(3), x.sum() > 0

    compiled = Compiled(checked)
    bound = compiled.bound(TREE)
    for call in (bound, lambda x: compiled(TREE, jnp.asarray(x))):
        good, which, sign = call(np.array([0.25, 0.5]))
        np.testing.assert_array_equal(good, 2.5 * np.array([0.25, 0.5]))
        bad, still, none = call(np.array([2.0, 0.5]))
        assert np.isnan(bad).all()
        assert bad.shape == (2,)
        np.testing.assert_array_equal(which, still)
        assert (bool(sign), bool(none)) == (True, False)
    assert compiled.compilations == 2


def test_other_errors_of_a_program_are_not_taken_for_numbers():
    def failing(x):
        return jax.pure_callback(lambda _: 1 / 0, jax.ShapeDtypeStruct((), float), x)

    with pytest.raises(jax.errors.JaxRuntimeError, match="division by zero"):
        Compiled(failing)(jnp.asarray(1.0))


def _far(x):
    """Sines that several derivatives take, behind barriers."""
    sines = jax.lax.optimization_barrier(jnp.sin(x))
    return sines * jnp.roll(sines, 1) + jnp.cumsum(sines)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="options of XLA on CPUs")
@pytest.mark.parametrize("use", Use)
def test_this_xla_knows_the_options_and_lets_barriers_last(use):
    lowered = jax.jit(_far).lower(jnp.ones(4))
    assert "opt-barrier" in str(lowered.compile(compiler_options=use.value).as_text())
    assert "opt-barrier" not in str(lowered.compile().as_text())


def test_an_xla_that_knows_other_options_goes_by_its_own(monkeypatch):
    monkeypatch.setitem(Use.ONCE.value, "xla_of_another_year", "true")
    compiled = Compiled(_far, use=Use.ONCE)
    x = np.linspace(0.0, 1.0, 4)
    np.testing.assert_allclose(compiled(jnp.asarray(x)), np.sin(x) * np.roll(np.sin(x), 1) + np.cumsum(np.sin(x)))


def test_however_little_a_program_is_optimised_its_numbers_are_the_same():
    x = jnp.linspace(-3.0, 3.0, 50)
    few, rows, loops = (np.asarray(Compiled(jax.jacfwd(_far), use=use)(x)) for use in Use)
    np.testing.assert_allclose(few, rows, rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(rows, loops, rtol=1e-13, atol=1e-14)


def test_what_a_program_is_for_may_depend_on_what_it_is_given():
    seen = []

    def use(x):
        seen.append(x.shape)
        return Use.ROWS

    assert float(Compiled(jnp.sum, use=use)(jnp.ones(3))) == 3.0
    assert seen == [(3,)]
