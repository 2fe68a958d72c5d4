"""Simultaneous programs: their derivatives, their sparsity, and what their first point means."""

import numpy as np
import pytest
from collocated_problems import everything, free_torque, integrated, robustly_fed

import aleator as al
from aleator.transcription import transcribe
from aleator.transcription.simultaneous import _tiles

_COLUMNS = 30


def _point_beside(program):
    rng = np.random.default_rng(1)
    return rng, program.start + 0.05 * program.variable_scale * rng.standard_normal(program.start.size)


DECIDED_KNOTS = free_torque(spans=al.Decision(np.ones(3), 0.2, 5.0))
PROGRAMS = {
    "Hermite and Simpson": (everything, al.schemes.HermiteSimpson()),
    "decided knots": (lambda: everything(DECIDED_KNOTS), al.schemes.Radau(1)),
    "algebraic variables": (lambda: robustly_fed(4), al.schemes.HermiteSimpson()),
    "statistics over time": (integrated, al.schemes.HermiteSimpson()),
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (i > 0)) for i, name in enumerate(PROGRAMS)]
)
def test_derivatives_of_both_orders_are_those_of_central_differences(name):
    problem, scheme = PROGRAMS[name]
    program = transcribe(problem(), al.Simultaneous(scheme)).program
    rng, point = _point_beside(program)
    found = program.evaluate(point)
    jacobian, multipliers = found.jacobian.toarray(), rng.standard_normal(len(found.constraints))
    lower = program.hessian.evaluate(point, 1.3, multipliers).toarray()
    hessian = lower + np.tril(lower, -1).T
    # All decisions, and some of every other kind of variable.
    for i in np.append(np.arange(9), rng.choice(point.size, _COLUMNS, replace=False)):
        step = 1e-6 * program.variable_scale[i] * np.eye(point.size)[i]
        one, other = program.evaluate(point + step), program.evaluate(point - step)
        h = 2 * step[i]
        slope, gradient = (one.constraints - other.constraints) / h, (one.objective - other.objective) / h
        bend = [1.3 * part.gradient + multipliers @ part.jacobian for part in (one, other)]
        np.testing.assert_allclose(jacobian[:, i], slope, atol=1e-7 * max(1, np.abs(slope).max()))
        assert found.gradient[i] == pytest.approx(gradient, abs=1e-7)
        difference = (bend[0] - bend[1]) / h
        np.testing.assert_allclose(hessian[:, i], difference, atol=1e-6 * max(1, np.abs(difference).max()))


@pytest.mark.slow
def test_tiles_of_any_size_give_the_same_program(monkeypatch):
    problem, scheme = PROGRAMS["decided knots"]
    program = transcribe(problem(), al.Simultaneous(scheme)).program
    rng, point = _point_beside(program)
    multipliers = rng.standard_normal(len(program.constraint_lower))
    # Neither the realisations nor the points of the mesh are a multiple of these.
    for limit, value in (("_LEAST", 1), ("_MOST", 10), ("_MOST_OUTER", 5), ("_STEP", 4)):
        monkeypatch.setattr(_tiles, limit, value)
    other = transcribe(problem(), al.Simultaneous(scheme)).program
    one, two = program.evaluate(point), other.evaluate(point)
    np.testing.assert_allclose(one.constraints, two.constraints, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(one.jacobian.toarray(), two.jacobian.toarray(), rtol=1e-12, atol=1e-12)
    bends = [each.hessian.evaluate(point, 1.3, multipliers).toarray() for each in (program, other)]
    np.testing.assert_allclose(*bends, rtol=1e-11, atol=1e-11 * np.abs(bends[0]).max())


def test_no_entry_of_the_hessian_couples_two_realisations():
    transcribed = transcribe(everything(), al.Simultaneous())
    owner = np.full(transcribed.program.start.size, -1)
    numbers = transcribed.layout.numbers
    for part in (numbers.phases[0].states, numbers.phases[0].paths, numbers.phases[0].integrals):
        for i, some in enumerate(part):
            owner[some] = i
    entries = transcribed.program.hessian.sparsity.tocoo()
    first, second = owner[entries.row], owner[entries.col]
    assert np.all((first == second) | (first < 0) | (second < 0))
