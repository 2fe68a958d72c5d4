"""Collocation points in parts, on as many threads as may be: the numbers of one system after the other."""

from itertools import product
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import legendre

import aleator as al
from aleator.transcription import transcribe
from aleator.transcription.sequential import EVALUATE, _shares
from aleator.transcription.sequential._evaluator import Blocks


class Oscillator(al.System):
    """`x'' = -k x - d x'³`, released at one."""

    states = ("x", "v")
    k: al.Number
    d: al.Number

    def initial(self):
        return {"x": 1.0}

    def rhs(self, t, z):
        return z.v, -self.k * z.x - self.d * z.v**3

    def outputs(self, t, z):
        return {"x": z.x, "power": self.d * z.v**4}


STEPS, HALF_K, HALF_D = 30, 0.4, 0.1


def oscillating(points=37, model: Any = Oscillator):
    return al.Problem(
        model(
            al.Uniform(al.Decision(4.0, 1.0, 9.0), half_width=HALF_K),
            al.Uniform(al.Decision(0.5, 0.1, 2.0), half_width=HALF_D),
        ),
        grid=al.Grid(2.0, STEPS),
        minimize=al.integral("power").mean + al.integral("power").std,
        subject_to=[al.path("x").at_most(2.0, sigmas=2.0), al.time_integral(al.path("x").std) <= 3.0],
        expansion=al.Expansion(order=3, points=points),
    )


@pytest.fixture(autouse=True)
def small_problems_in_parts(monkeypatch):
    monkeypatch.setattr(_shares, "_FEWEST_NUMBERS", 0)


@pytest.fixture
def all_threads_again():
    yield
    al.threads(None)


def evaluated(problem, x):
    transcription = transcribe(problem)
    return transcription, transcription.evaluator._evaluate(np.asarray(x))


def one_by_one(points, k, d):
    """Each oscillator by itself, and the coefficients of Legendre polynomials by NumPy."""
    found = [
        al.simulate(Oscillator(k + HALF_K * a, d + HALF_D * b), al.Grid(2.0, 2 * STEPS)) for a, b in np.asarray(points)
    ]
    orders = [one for one in product(range(4), repeat=2) if sum(one) <= 3]
    single = [legendre.legval(np.asarray(points), np.eye(4)[n] * np.sqrt(2 * n + 1)) for n in range(4)]
    matrix = np.stack([single[i][:, 0] * single[j][:, 1] for i, j in orders], axis=1)
    return {
        name: np.linalg.lstsq(matrix, np.stack([one[name] for one in found]), rcond=None)[0] for name in ("x", "power")
    }


def test_parts_give_statistics_and_derivatives_of_systems_simulated_one_by_one():
    transcription, blocks = evaluated(oscillating(), [4.0, 0.5])
    assert isinstance(blocks, Blocks)
    assert len(blocks.samples_in_parts) == 2
    points = transcription.collocation.points
    assert len(points) == 37

    def rows(k, d):
        x = one_by_one(points, k, d)["x"]
        return x[0] + 2 * np.sqrt(np.sum(x[1:] ** 2, axis=0))

    own, h = blocks.by_constraint(blocks.values)[0], 1e-4
    # On twice as many steps, so that what is compared with is another computation: the error of a step is its own.
    np.testing.assert_allclose(own, rows(4.0, 0.5)[::2], atol=2e-5)
    slopes = np.stack(
        [(rows(4.0 + h, 0.5) - rows(4.0 - h, 0.5)) / 2 / h, (rows(4.0, 0.5 + h) - rows(4.0, 0.5 - h)) / 2 / h], axis=1
    )
    np.testing.assert_allclose(blocks.by_constraint(blocks.derivatives)[0], slopes[::2], atol=2e-4)


@pytest.mark.parametrize("points", [36, 37, 300])
def test_parts_agree_with_all_points_at_once_up_to_rounding(points):
    problem = oscillating(points)
    transcription, parts = evaluated(problem, [3.5, 0.6])
    traced, collocation, anchors = transcription.evaluator._given
    given = traced, collocation, transcription.constants, anchors
    whole = Blocks._make((*EVALUATE.bound(*given)(np.array([3.5, 0.6])), points))
    for name in ("values", "derivatives", "times"):
        one, other = getattr(parts, name), getattr(whole, name)
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-13 * np.abs(other).max(), err_msg=name)
    np.testing.assert_array_equal(parts.sizes, whole.sizes)
    for name in ("samples", "tangents", "statistics"):
        for one, other in zip(getattr(parts, name), getattr(whole, name), strict=True):
            assert one.shape == other.shape
            np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("points", [36, 37, 300])
def test_digits_do_not_depend_on_the_number_of_threads(points, all_threads_again):
    found = []
    for count in (1, 2, 5):
        al.threads(count)
        _, blocks = evaluated(oscillating(points), [4.0, 0.5])
        found.append([blocks.values, blocks.derivatives, *blocks.samples, *blocks.tangents, *blocks.statistics])
    for other in found[1:]:
        for one, same in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(one, same)


def test_parts_are_of_one_size_and_their_fill_contributes_nothing():
    transcription = transcribe(oscillating())
    parts = _shares.parts_of(transcription.problem, transcription.collocation, transcription.constants)
    assert [one.points.shape for one in parts] == [(19, 2), (19, 2)]
    np.testing.assert_array_equal(parts[1].points[-1], parts[1].points[-2])
    assert not parts[1].fit[:, -1].any()
    joined = np.concatenate([one.points for one in parts])
    np.testing.assert_array_equal(joined[:37], transcription.collocation.points)


def test_small_problems_stay_one_program(monkeypatch):
    monkeypatch.undo()
    transcription, blocks = evaluated(oscillating(), [4.0, 0.5])
    assert transcription.problem.grid.steps * 37 * 3 < _shares._FEWEST_NUMBERS
    assert len(blocks.samples_in_parts) == 1


class Bursting(Oscillator):
    """Oscillates, but for springs beyond a stiffness: those are not a number."""

    def outputs(self, t, z):
        good = jnp.where(self.k > 4.37, jnp.nan, 1.0)
        return {**super().outputs(t, z), "x": good * z.x}


def test_a_system_that_is_not_a_number_in_any_part_leaves_no_number():
    problem = oscillating(model=Bursting)
    transcription = transcribe(oscillating())
    beyond = 4.0 + HALF_K * np.asarray(transcription.collocation.points)[:, 0] > 4.37
    assert beyond.any()
    assert not beyond.all()
    with pytest.raises(al.SimulationError, match="x"):
        al.solve(problem)


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
def test_what_a_part_raises_is_raised(which, error):
    transcription = transcribe(oscillating())
    evaluate: Any = transcription.evaluator.with_constants(transcription.constants)._evaluate

    class Failing:
        def prepare(self, last):
            pass

        def __call__(self, last):
            raise error

    evaluate._parts[which] = Failing()
    with pytest.raises(error):
        evaluate(np.array([4.0, 0.5]))
