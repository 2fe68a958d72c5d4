"""Simultaneous programs: their derivatives, their sparsity, and what their first point means."""

import numpy as np
import pytest
from collocated_problems import everything, free_torque, integrated, robustly_fed, turned

import aleator as al
from aleator.nlp import Condensing, Ipopt
from aleator.transcription import transcribe
from aleator.transcription.simultaneous import _tiles
from aleator.transcription.simultaneous._transcribed import SimultaneouslyTranscribed
from zoo import Pendulum

_COLUMNS = 30


def _point_beside(program):
    rng = np.random.default_rng(1)
    return rng, program.start + 0.05 * program.variable_scale * rng.standard_normal(program.start.size)


DECIDED_KNOTS = free_torque(spans=al.Decision(np.ones(3), 0.2, 5.0))
PROGRAMS = {
    "Hermite and Simpson": (everything, al.schemes.HermiteSimpson()),
    "decided knots": (lambda: everything(DECIDED_KNOTS), al.schemes.Radau(1)),
    "Gauss": (everything, al.schemes.GaussLegendre(2)),
    "algebraic variables": (lambda: robustly_fed(4), al.schemes.HermiteSimpson()),
    "statistics over time": (integrated, al.schemes.HermiteSimpson()),
    "segments": (everything, al.schemes.MultipleShooting(2)),
    "segments with algebraic variables": (lambda: robustly_fed(4), al.schemes.MultipleShooting(2)),
    "segments with statistics over time": (integrated, al.schemes.MultipleShooting(1)),
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
@pytest.mark.parametrize("name", ["Hermite and Simpson", "decided knots", "segments"])
def test_tiles_of_any_size_give_the_same_program(name, monkeypatch):
    problem, scheme = PROGRAMS[name]
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
    for part in (numbers.states, numbers.paths, numbers.integrals):
        for i, some in enumerate(part):
            owner[some] = i
    entries = transcribed.program.hessian.sparsity.tocoo()
    first, second = owner[entries.row], owner[entries.col]
    assert np.all((first == second) | (first < 0) | (second < 0))


@pytest.mark.slow
@pytest.mark.parametrize("problem", [everything, turned, integrated])
def test_the_first_point_is_the_simulation(problem):
    problem = problem()
    usual, other = transcribe(problem), transcribe(problem, al.Simultaneous())
    one, same = usual.at(usual.program.start), other.at(other.program.start)
    assert same.objective == pytest.approx(one.objective, rel=5e-3)
    for ours, theirs in zip(same.constraints, one.constraints, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=5e-3 * max(1.0, np.abs(theirs).max()))
    for ours, theirs in zip(same.statistics, one.statistics, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=5e-3 * max(1.0, np.abs(theirs).max()))
    np.testing.assert_allclose(same.times, one.times, rtol=1e-14)


TORQUES = {
    "control points": (free_torque(), True),
    "an end at a decided speed": (free_torque(end=(0.0, al.Decision(0.1))), False),
    "decided knots": (DECIDED_KNOTS, False),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", TORQUES)
def test_signals_are_affine_unless_decisions_are_multiplied_or_divided(name):
    """The final time is decided as well: a speed at the end sets a control point by the duration times it."""
    torque, is_affine = TORQUES[name]
    assert transcribe(everything(torque), al.Simultaneous()).layout.plan.is_affine == is_affine


@pytest.mark.slow
def test_a_spline_with_a_control_point_at_each_instant_stays_sparse():
    """Between two instants it depends on degree + 1 of them."""
    sizes = []
    for count in (10, 20, 40):
        torque = al.BSpline(al.Decision(np.zeros(count + 1), -20.0, 20.0), degree=1)
        program = transcribe(turned(count, inputs={"torque": torque}), al.Simultaneous()).program
        sizes.append((program.sparsity.nnz, program.hessian.sparsity.nnz))
    first, second = np.diff(sizes, axis=0)
    # Where an instant is a knot but for rounding, one entry more or less.
    np.testing.assert_allclose(second, 2 * first, rtol=1e-4)


def test_entries_grow_with_intervals_and_points_alone():
    sizes = []
    for intervals in (10, 20):
        program = transcribe(turned(intervals), al.Simultaneous()).program
        sizes.append((program.sparsity.nnz, program.hessian.sparsity.nnz))
    (jacobian, hessian), (twice, twice_hessian) = sizes
    assert twice < 2.1 * jacobian
    assert twice_hessian < 2.1 * hessian


def test_signals_of_the_system_itself_depend_on_decisions():
    """Torques are part of `ForwardDynamics`: each mesh point depends on them through the signals alone."""
    torque = {"angle_torque": al.BSpline(al.Decision(np.zeros(6), -5.0, 5.0))}
    problem = al.Problem(
        al.ForwardDynamics(Pendulum(length=al.Uniform(1.0, half_width=0.1)), torque=torque, start={"angle": 0.3}),
        grid=al.Grid(1.0, 5),
        minimize=al.objectives.effort("angle_torque"),
        subject_to=[al.terminal("angle").mean.equals(0.5)],
        expansion=al.Expansion(order=1),
    )
    transcribed = transcribe(problem, al.Simultaneous())
    numbers, program = transcribed.layout.numbers, transcribed.program
    assert np.all(program.lower[numbers.signals] < program.upper[numbers.signals])
    jacobian = program.evaluate(program.start).jacobian
    ties = transcribed.assembled.rows.ties
    of_states = np.isin(ties.variables, numbers.states)
    assert abs(jacobian[ties.rows][of_states][:, numbers.decisions]).nnz == 0
    of_signals = np.isin(ties.variables, numbers.signals)
    assert abs(jacobian[ties.rows][of_signals][:, numbers.decisions]).nnz > 0


CONDENSED = {
    "fixed": ({}, al.schemes.HermiteSimpson()),
    "final time": ({"grid": al.Grid(al.Decision(1.0, 0.8, 1.5), 8)}, al.schemes.HermiteSimpson()),
    "segments": ({"grid": al.Grid(al.Decision(1.0, 0.8, 1.5), 8)}, al.schemes.MultipleShooting(2)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CONDENSED)
def test_condensing_has_the_optimum_of_ipopt(name):
    limits, scheme = CONDENSED[name]
    program = transcribe(turned(8, **limits), al.Simultaneous(scheme)).program
    own, other = Condensing().solve(program), Ipopt().solve(program)
    assert own.message == "solved"
    assert own.evaluation.objective == pytest.approx(other.evaluation.objective, rel=1e-6)
    np.testing.assert_allclose(own.point, other.point, rtol=1e-4, atol=1e-5)


def test_ties_name_the_realisation_of_each_variable():
    transcribed = transcribe(turned(4), al.Simultaneous())
    assert isinstance(transcribed, SimultaneouslyTranscribed)
    ties, numbers = transcribed.program.ties, transcribed.layout.numbers
    assert ties is not None
    owners = dict(zip(ties.variables, ties.owners, strict=True))
    for p, (states, ends) in enumerate(zip(numbers.states, numbers.ends, strict=True)):
        assert {owners[one] for one in (*states.ravel(), *ends)} == {p}
    assert {owners[one] for one in numbers.signals.ravel()} == {-1}
    # The duration is given here, and so fixed.
    free = np.flatnonzero(transcribed.program.lower < transcribed.program.upper)
    np.testing.assert_array_equal(np.setdiff1d(free, ties.variables), numbers.decisions)
