"""Functions of realisations at many points, against closed forms: whatever the batches, traced or called."""

import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import aleator as al
from aleator._core.compilation import Compiled
from aleator.ensemble import (
    CalledEnsemble,
    TracedEnsemble,
    at_levels,
    draw,
    in_batches,
    parts,
    random_levels,
    uncertain_places,
)
from aleator.uncertainty import placements

# Uniform on [0.5, 1.5] by its decision's initial value, normal, and a number that is certain.
MODEL = {"a": al.Uniform(al.Decision(1.0, 0.0, 3.0), half_width=0.5), "b": al.Normal(2.0, 0.1), "c": 3.0}
LEVELS = np.random.default_rng(0).uniform(0.01, 0.99, (13, 2))
A, B = stats.uniform(0.5, 1.0).ppf(LEVELS[:, 0]), stats.norm(2.0, 0.1).ppf(LEVELS[:, 1])
EXACT = {"product": 3.0 * A * B, "path": np.stack([A, B**2], axis=1)}
KINDS = pytest.mark.parametrize("kind", [TracedEnsemble, CalledEnsemble])


def outputs(m):
    library = jnp if isinstance(m["a"], jax.Array) else np
    return {"product": m["c"] * m["a"] * m["b"], "path": library.stack([m["a"], m["b"] ** 2])}


def ensemble(kind, function=outputs, model=MODEL):
    return kind(function, model, uncertain_places("test", function, model))


@KINDS
@pytest.mark.parametrize("size", [5])
def test_outputs_are_those_of_the_realisations_whatever_the_batches(kind, size):
    found = list(ensemble(kind).in_parts(parts(LEVELS, size), size))
    np.testing.assert_array_equal(np.concatenate([part.points for part, _ in found]), LEVELS)
    assert [part.first for part, _ in found] == list(range(0, 13, size))
    for name, exact in EXACT.items():
        np.testing.assert_allclose(np.concatenate([values[name] for _, values in found]), exact, rtol=1e-13)


@KINDS
def test_all_points_at_once_are_germ_points(kind):
    found = ensemble(kind)(jnp.asarray(at_levels(placements(MODEL).germs.values(), LEVELS)))
    for name, exact in EXACT.items():
        np.testing.assert_allclose(found[name], exact, rtol=1e-13)


def test_many_known_points_are_evaluated_by_one_program_of_few():
    levels = np.random.default_rng(1).uniform(0.01, 0.99, (2500, 2))
    a, b = stats.uniform(0.5, 1.0).ppf(levels[:, 0]), stats.norm(2.0, 0.1).ppf(levels[:, 1])
    traces = []

    def product(m):
        traces.append(m)
        return m["c"] * m["a"] * m["b"]

    one, before = ensemble(TracedEnsemble, product), []
    for count in (2500, 2000):
        points = at_levels(placements(MODEL).germs.values(), levels[:count])
        np.testing.assert_allclose(one(points), (3.0 * a * b)[:count], rtol=1e-13)
        before.append(len(traces))
    assert before[0] == before[1]


def broken_from(limit):
    def broken(m):
        library = jnp if isinstance(m["a"], jax.Array) else np
        with np.errstate(invalid="ignore"):
            return {"fine": m["b"], "root": library.sqrt(limit - m["a"])}

    return broken


@KINDS
@pytest.mark.parametrize(("size", "where"), [(4, "1 of 4 points after 4 finite ones")])
def test_what_is_not_finite_is_named_with_its_point_and_its_inputs(kind, size, where):
    # a = 0.5 + level: beyond 1.2 at the sixth point and at the tenth.
    levels = np.full((10, 2), 0.5)
    levels[[5, 9], 0] = 0.75, 0.8
    with pytest.raises(al.SimulationError, match=rf"'broken' .* {where}.*'root' first at point 6 \(a=1.25, b=2\)"):
        list(ensemble(kind, broken_from(1.2)).in_parts(parts(levels, size), size))


@KINDS
@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda m: None, "returns nothing"),
        (lambda m: m["a"] + 1j, "real array.* complex"),
        (
            lambda m: {"y": m["a"], "z": np.zeros((3, 0))},
            r"output 'z': expected .* received an array of shape \(3, 0\)",
        ),
    ],
)
def test_what_is_no_real_array_is_refused(kind, function, message):
    with pytest.raises(al.ProblemError, match=message):
        ensemble(kind, function)(np.zeros((3, 2)))


def test_a_called_function_that_fails_names_the_germ_point_and_the_values_there():
    def diverging(m):
        if m["a"] > 1.2:
            raise ValueError("no root\nwas found")
        return m["a"]

    points = np.array([[0.0, 0.0], [0.5, -1.0], [0.0, 0.5]])
    where = r"germ point \(0\.5, -1\), where a=1\.25, b=1\.9\."
    with pytest.raises(al.SimulationError, match=rf"'diverging' raised ValueError: no root, at {where}") as raised:
        ensemble(CalledEnsemble, diverging)(points)
    assert isinstance(raised.value.__cause__, ValueError)


@pytest.mark.parametrize("size", [1, 13])
def test_shapes_that_change_are_refused_within_a_batch_and_between_them(size):
    def growing(m):
        return {"y": np.zeros(1 if m["a"] < 1.0 else 2)}

    with pytest.raises(al.ProblemError, match=r"'growing' must return .*same shapes .* \{'y': \([12],\)\} and \{'y'"):
        list(ensemble(CalledEnsemble, growing).in_parts(parts(LEVELS, size), size))


def test_what_looks_at_its_numbers_cannot_be_traced_but_called():
    def branching(m):
        return 1.0 if m["a"] < 1.0 else 2.0

    with pytest.raises(al.ProblemError, match=r"'branching' cannot be traced by JAX .*traced=False"):
        ensemble(TracedEnsemble, branching).in_parts(parts(LEVELS, 5), 5)
    found = [values for _, values in ensemble(CalledEnsemble, branching).in_parts(parts(LEVELS, 5), 5)]
    np.testing.assert_array_equal(np.concatenate(found), np.where(A < 1.0, 1.0, 2.0))


def test_germ_points_are_quantiles_and_random_ones_depend_on_the_seed_alone():
    distributions = {"a": al.Uniform.bounds(-1.0, 1.0), "b": al.Normal(0.0, 1.0)}
    germs = tuple(placements(distributions).germs.values())
    exact = [stats.uniform(-1, 2).ppf(LEVELS[:, 0]), stats.norm.ppf(LEVELS[:, 1])]
    np.testing.assert_allclose(at_levels(germs, LEVELS), np.stack(exact, axis=1), rtol=1e-13, atol=1e-15)
    many, few = (draw(germs, count, np.random.default_rng(7)) for count in (1000, 10))
    np.testing.assert_array_equal(many[:10], few)
    np.testing.assert_array_equal(many, at_levels(germs, random_levels(np.random.default_rng(7), 1000, 2)))
    assert stats.kstest(many[:, 1], "norm").pvalue > 1e-3


@pytest.mark.parametrize("count", [1, 131])
def test_a_program_is_compiled_for_one_size_by_the_thread_that_asks(count):
    ran_by = []

    def squares(model, points, decisions):
        ran_by.append(threading.current_thread())
        return {"square": model["by"] * points[:, 0] ** 2, "moved": points + decisions[None]}

    program, points = Compiled(squares), np.random.default_rng(count).normal(size=(count, 2))
    found = in_batches(program, {"by": jnp.asarray(2.0)}, points, jnp.asarray([1.0, -1.0]))
    np.testing.assert_allclose(found["square"], 2.0 * points[:, 0] ** 2, rtol=1e-14)
    np.testing.assert_allclose(found["moved"], points + np.array([1.0, -1.0]), rtol=1e-14)
    assert program.compilations == 1
    assert ran_by == [threading.current_thread()]
