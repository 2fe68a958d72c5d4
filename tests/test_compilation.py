"""Executables: one for each structure of the arguments, and the same numbers however they travel."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aleator._core.compilation import Compiled, Use
from aleator._core.equations import loop_while_any
from aleator._core.programs import Programs


def _results(tree, kind, x):
    products = {name: part * x.sum() for name, part in tree["parts"].items()}
    return products, jnp.arange(3) + tree["shift"], (x.sum() > 0, jnp.zeros((0, 2))), kind


TREE = {"parts": {"a": np.arange(6.0).reshape(3, 2), "b": np.asarray(2.5)}, "shift": np.asarray(4)}
SEVEN = np.asarray(7)


def test_bound_functions_give_every_array_its_shape_kind_and_numbers_back_and_share_an_executable():
    compiled = Compiled(_results)
    x = np.array([0.5, -3.0])
    found = compiled.bound(TREE, SEVEN)(x)
    products = {"a": -2.5 * TREE["parts"]["a"], "b": -2.5 * 2.5}
    expected = products, np.arange(3) + 4, (np.asarray(False), np.zeros((0, 2))), SEVEN
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert isinstance(one, np.ndarray)
        assert one.dtype == np.asarray(other).dtype
        np.testing.assert_array_equal(one, other)
    with pytest.raises(ValueError, match="read-only"):
        found[0]["a"][0, 0] = 1.0
    second = compiled.bound(jax.tree.map(lambda leaf: 2 * leaf, TREE), SEVEN)(x)
    assert compiled.compilations == 1
    np.testing.assert_array_equal(second[0]["a"], 2 * found[0]["a"])
    compiled.bound(TREE | {"parts": {"a": TREE["parts"]["a"]}}, SEVEN)(x)
    assert compiled.compilations == 2


def test_what_a_check_of_a_library_stops_gives_no_number_in_the_right_shape():
    def checked(tree, x):
        return eqx.error_if(x, x.sum() > 1, "too large") * tree["parts"]["b"], jnp.arange(3), x.sum() > 0

    compiled = Compiled(checked)
    for call in (compiled.bound(TREE), lambda x: compiled(TREE, x)):
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


def test_what_is_prepared_is_not_compiled_again():
    compiled = Compiled(lambda scale, x: scale["by"] * x)
    compiled.prepare({"by": jnp.asarray(1.0)}, np.zeros(3))
    np.testing.assert_array_equal(compiled({"by": jnp.asarray(2.0)}, np.arange(3.0)), [0.0, 2.0, 4.0])
    assert compiled.compilations == 1


def _far(x):
    """Sines that several derivatives take, behind barriers."""
    sines = jax.lax.optimization_barrier(jnp.sin(x))
    return sines * jnp.roll(sines, 1) + jnp.cumsum(sines)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="options of XLA on CPUs")
def test_this_xla_knows_the_options_which_let_barriers_last_and_numbers_be_the_same(monkeypatch):
    x = np.linspace(-3.0, 3.0, 50)
    lowered = jax.jit(_far).lower(x)
    for use in Use:
        assert "opt-barrier" in str(lowered.compile(compiler_options=use.value).as_text())
    first, *others = (np.asarray(Compiled(jax.jacfwd(_far), use=use)(x)) for use in Use)
    for other in others:
        np.testing.assert_allclose(first, other, rtol=1e-13, atol=1e-14)
    monkeypatch.setitem(Use.ONCE.value, "xla_of_another_year", "true")
    expected = np.sin(x) * np.roll(np.sin(x), 1) + np.cumsum(np.sin(x))
    np.testing.assert_allclose(Compiled(_far, use=Use.ONCE)(x), expected, atol=1e-12)


def test_only_so_many_programs_are_kept():
    kept = Programs(most=2)
    for key in "abac":
        assert not kept[key].is_ready
    assert [key in kept for key in "abc"] == [True, False, True]


def _until(x):
    return jax.lax.while_loop(lambda y: jnp.sum(y**2) > 1.0, lambda y: y / 2, x)


def test_a_loop_of_many_realisations_that_ends_by_a_condition_is_compiled_with_some_optimisation():
    x = np.ones(3)
    assert Use.BRIEF.of(jax.make_jaxpr(jax.vmap(jax.jit(_until)))(np.ones((2, 3)))) is Use.ONCE
    assert Use.BRIEF.of(jax.make_jaxpr(jax.jit(_until))(x)) is Use.BRIEF
    assert Use.BRIEF.of(jax.make_jaxpr(lambda x: jax.lax.fori_loop(0, 9, lambda _, y: y / 2, x))(x)) is Use.BRIEF
    np.testing.assert_allclose(Compiled(_until, use=Use.BRIEF)(x), 0.5)


def _halved(x, times):
    """`x / 2**times`, in a loop that leaves what is finished as it is."""

    def advance(state):
        x, left = state
        return jnp.where(left > 0, x / 2, x), jnp.maximum(left - 1, 0)

    return loop_while_any(lambda state: state[1] > 0, advance, (x, times))[0]


def test_a_loop_that_many_take_together_lasts_until_all_have_finished():
    x, times = np.array([3.0, 5.0, 7.0, 9.0]), np.array([3, 0, 1, 7])
    both = jax.vmap(lambda x, times: jax.jvp(lambda x: _halved(x, times), (x,), (1.0,)))
    values, slopes = map(np.asarray, Compiled(both, use=Use.BRIEF)(x, times))
    assert (values == x / 2.0**times).all()
    assert (slopes == 1 / 2.0**times).all()
    # Whether it goes on is known from the step before, so that no two answers can differ.
    assert Use.BRIEF.of(jax.make_jaxpr(both)(x, times)) is Use.BRIEF
