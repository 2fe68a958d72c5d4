"""Rows that limit the peaks of the path that they sample: closed forms and differences."""

import numpy as np
import pytest
import scipy

from aleator.nlp import Evaluation, Hessian, NonlinearProgram, Peak, extreme, with_peaks

TIMES = np.array([0.0, 0.3, 0.7, 1.0, 1.5])


@pytest.mark.parametrize("side", [1, -1])
def test_the_extreme_of_a_parabola_is_its_vertex_within_its_places_and_an_end_outside(side):
    places = TIMES[1:4]

    def at(vertex):
        return extreme(places, side * (2.0 - 3.0 * (places - vertex) ** 2), side)

    inside = at(0.55)
    assert inside.value == pytest.approx(2.0 * side)
    assert inside.weights.sum() == pytest.approx(1.0)
    outside = at(1.4)
    assert outside.value == pytest.approx(side * (2.0 - 3.0 * 0.4**2))
    np.testing.assert_allclose(outside.weights, [0.0, 0.0, 1.0], atol=1e-12)
    assert outside.bend == 0.0


def wave(sparse):
    """A wave `x0 sin(2 t + x1) + x2 t` at five places, none of which sees its peak; the last variable is free of it."""

    def parts(x):
        phase = 2 * TIMES + x[1]
        return phase, np.stack([np.sin(phase), x[0] * np.cos(phase), TIMES, 0 * TIMES], axis=1)

    def evaluate(x):
        phase, jacobian = parts(x)
        rows = x[0] * np.sin(phase) + x[2] * TIMES
        objective = np.sum((x - [2.0, 0.7, 0.3, 1.0]) ** 2)
        own = jacobian
        if sparse:  # with its zeros
            own = scipy.sparse.csr_array((jacobian[:, :3].ravel(), np.tile(np.arange(3), 5), 3 * np.arange(6)), (5, 4))
        return Evaluation(float(objective), 2 * (x - [2.0, 0.7, 0.3, 1.0]), rows, own)

    def second(x, weight, multipliers):
        phase, _ = parts(x)
        by_phase, mixed = -multipliers @ (x[0] * np.sin(phase)), multipliers @ np.cos(phase)
        whole = 2 * weight * np.eye(4)
        whole[1, 1] += by_phase
        whole[1, 0] += mixed
        return scipy.sparse.csr_array((whole[pattern.nonzero()], pattern.indices, pattern.indptr), (4, 4))

    pattern = scipy.sparse.csr_array(np.array([[1, 0, 0, 0], [1, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=bool))
    full = np.array([[True, True, True, False]] * 5)
    return NonlinearProgram(
        evaluate=evaluate,
        start=np.array([1.0, 0.5, 0.1, 0.0]),
        lower=np.full(4, -5.0),
        upper=np.full(4, 5.0),
        constraint_lower=np.full(5, -9.0),
        constraint_upper=np.full(5, 1.2),
        constraint_scale=np.ones(5),
        variable_scale=np.ones(4),
        sparsity=evaluate(np.ones(4)).jacobian.astype(bool) if sparse else full,
        hessian=Hessian(second, pattern),
    )


def peaked(sparse):
    """With a peak around the second place and a trough around the fourth."""
    peaks = [Peak(np.arange(i - 1, i + 2), TIMES[i - 1 : i + 2], side) for i, side in ((1, 1), (3, -1))]
    return with_peaks(wave(sparse), peaks)


@pytest.mark.parametrize("sparse", [False, True], ids=["dense", "sparse"])
def test_derivatives_of_peaks_are_those_of_their_values(sparse):
    program, x, h = peaked(sparse), np.array([1.3, 0.6, 0.2, 0.4]), 1e-6
    weights = np.array([0.3, 2, -1, 1.5, 1])

    def dense(one):
        return one if isinstance(one, np.ndarray) else one.toarray()

    def differences(of):
        return np.stack([(of(x + h * step) - of(x - h * step)) / (2 * h) for step in np.eye(4)], axis=-1)

    def slope(at):
        here = program.evaluate(at)
        return 0.7 * here.gradient + weights @ dense(here.jacobian)

    here = program.evaluate(x)
    assert here.constraints[1] > wave(sparse).evaluate(x).constraints[:3].max()
    np.testing.assert_allclose(
        dense(here.jacobian), differences(lambda at: program.evaluate(at).constraints), atol=1e-8
    )
    lower = program.hessian.evaluate(x, 0.7, weights).toarray()
    np.testing.assert_allclose(lower, np.tril(differences(slope)), atol=1e-7)
