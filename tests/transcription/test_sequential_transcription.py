import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.transcription import transcribe
from aleator.transcription.sequential import EVALUATE
from tiny_models import ONE_STEP, RESPONSE, SPREAD, Gain, derivative_error, gain_problem, oscillator_problem


@pytest.mark.parametrize("declare", [oscillator_problem, lambda: al.deterministic(oscillator_problem())])
def test_derivatives_agree_with_central_differences(declare):
    transcription = transcribe(declare())
    program, point = transcription.program, np.array([0.9])
    exact = program.evaluate(point)
    assert np.isfinite(exact.jacobian).all()

    def values(x):
        evaluation = program.evaluate(x)
        return np.append(evaluation.constraints, evaluation.objective)

    jacobian = np.vstack([exact.jacobian, exact.gradient])
    assert derivative_error(values, jacobian, point) < 1e-6


def test_moments_and_statistics_of_a_linear_response_are_exact():
    transcription, point = transcribe(gain_problem()), np.array([1.7])
    response = transcription.resolve(point)["response(t_f)"]
    assert float(response.mean) == pytest.approx(1.7, rel=1e-12)
    assert float(response.std) == pytest.approx(1.7 * SPREAD, rel=1e-12)
    loss = (1.7 - 3.0) ** 2 + 1.0
    expected = {"μ[loss(t_f)]": loss, "μ[response(t_f)]": 1.7, "σ[response(t_f)]": 1.7 * SPREAD}
    assert transcription.statistics(point) == pytest.approx(expected, rel=1e-12)


def test_a_deterministic_problem_has_no_spread_and_no_broken_derivative():
    transcription = transcribe(al.deterministic(gain_problem(sigmas=3.0)))
    evaluation = transcription.program.evaluate(np.array([1.5]))
    assert evaluation.constraints.tolist() == [1.5]
    assert evaluation.jacobian.tolist() == [[1.0]]
    resolved = transcription.resolve(np.ones(1)).values()
    assert all(float(one.std) == 0.0 and float(one.leave_one_out) == 0.0 for one in resolved)


def test_a_problem_is_compiled_once_for_all_bounds_sigmas_and_numbers():
    def evaluate(problem):
        return transcribe(problem).program.evaluate(np.array([1.0]))

    first = evaluate(gain_problem())
    before = EVALUATE.compilations
    wider = evaluate(gain_problem().with_bound("response", 5.0))
    evaluate(gain_problem(upper=7.0))
    doubled = evaluate(gain_problem().with_sigmas("response", 2.0))
    other = evaluate(gain_problem(theta=al.Uniform(2.0, half_width=0.1)))
    assert EVALUATE.compilations == before
    # ... and the numbers are not those of the first problem.
    assert wider.constraints == pytest.approx(first.constraints)
    assert doubled.constraints == pytest.approx([1 + 2 * SPREAD])
    assert other.constraints == pytest.approx([2 + 0.1 / np.sqrt(3.0)])


def test_another_structure_is_compiled_anew():
    transcribe(gain_problem())
    before = EVALUATE.compilations
    transcribe(gain_problem(theta=al.Normal(1.0, 0.2), expansion=al.Expansion(2)))
    assert EVALUATE.compilations == before + 1


def test_rows_lead_back_to_constraints():
    transcription = transcribe(oscillator_problem())
    assert [(rows.start, rows.stop) for rows in transcription.rows] == [(0, 81), (81, 162)]
    assert transcription.program.constraint_upper[:81].tolist() == [0.14] * 81
    assert transcription.program.constraint_lower[81:].tolist() == [-0.14] * 81


def test_a_problem_without_decisions_is_refused():
    problem = al.Problem(Gain(1.0, al.Uniform(1.0, half_width=0.1)), grid=ONE_STEP, minimize=RESPONSE.mean)
    with pytest.raises(al.ProblemError, match="no decisions"):
        transcribe(problem)


def test_outputs_at_all_points_are_those_of_the_physics():
    transcription = transcribe(gain_problem())
    outputs = transcription.outputs(np.array([2.0]))
    theta = 1.0 + 0.3 * np.asarray(transcription.collocation.points)
    np.testing.assert_allclose(outputs["response"], np.repeat(2.0 * theta, 2, axis=1), rtol=1e-14)
    assert isinstance(outputs["response"], jnp.ndarray)
    assert dataclasses.is_dataclass(transcription)
