"""Sequential programs: values in closed form, first and second derivatives against differences, rows and programs."""

import numpy as np
import pytest

import aleator as al
from aleator.transcription import transcribe
from aleator.transcription.sequential import EVALUATE
from zoo import SPREAD, Launched, algebraic, central_differences, derivative_error, gain_problem

EXACT = al.Sequential(second_derivatives=True)


def pushed(**options):
    """A block of uncertain mass, pushed by a table of three forces: limits and objectives of every kind."""
    x, effort = al.rms("x"), al.integral("effort")
    defaults = {
        "minimize": x.std * effort.mean,
        "subject_to": [
            al.path("x").at_most(0.5, sigmas=2.0),
            al.terminal("x").mean ** 2 <= 0.04,
        ],
        "expansion": al.Expansion(order=2),
        "grid": al.Grid(2.0, 2),
    }
    mass = al.Uniform(al.Decision(1.0, 0.5, 2.0), half_width=0.1)
    push = al.Tabulated(np.linspace(0.0, 2.0, 3), al.Decision(np.zeros(3), -1.0, 1.0))
    defaults["inputs"] = {"force": push}
    return al.Problem(Launched(mass, speed=1.0), **(defaults | options))


def test_first_and_second_derivatives_agree_with_central_differences():
    program = transcribe(pushed(), EXACT).program
    generator = np.random.default_rng(3)
    x = program.start + 0.05 * generator.uniform(0.2, 1.0, program.start.size)
    multipliers, weight = generator.uniform(-1.0, 1.0, program.constraint_lower.size), 0.7
    exact = program.evaluate(x)
    assert np.isfinite(exact.jacobian).all()

    def values(point):
        found = program.evaluate(point)
        return np.append(found.constraints, found.objective)

    def slope(point):
        found = program.evaluate(point)
        return weight * found.gradient + multipliers @ found.jacobian

    assert derivative_error(values, np.vstack([exact.jacobian, exact.gradient]), x) < 1e-6
    assert program.hessian is not None
    found, bends = program.hessian.evaluate(x, weight, multipliers).toarray(), central_differences(slope, x, 1e-5)
    np.testing.assert_allclose(found, np.tril(bends), atol=2e-6 * np.abs(bends).max())


def test_moments_statistics_and_outputs_of_a_linear_response_are_exact():
    transcription, point = transcribe(gain_problem()), np.array([1.7])
    response = transcription.resolve(point)["response(t_f)"]
    assert (float(response.mean), float(response.std)) == pytest.approx((1.7, 1.7 * SPREAD), rel=1e-12)
    loss = (1.7 - 3.0) ** 2 + 1.0
    expected = {"μ[loss(t_f)]": loss, "μ[response(t_f)]": 1.7, "σ[response(t_f)]": 1.7 * SPREAD}
    assert transcription.statistics(point) == pytest.approx(expected, rel=1e-12)
    theta = 1.0 + 0.3 * np.asarray(transcription.collocation.points)
    outputs = transcription.outputs(point)["response"]
    np.testing.assert_allclose(outputs, np.repeat(1.7 * theta, 2, axis=1), rtol=1e-14)


def test_a_deterministic_problem_has_no_spread_and_no_broken_derivative():
    transcription = transcribe(al.deterministic(gain_problem(sigmas=3.0)))
    evaluation = transcription.program.evaluate(np.array([1.5]))
    assert evaluation.constraints.tolist() == [1.5]
    assert evaluation.jacobian.tolist() == [[1.0]]
    resolved = transcription.resolve(np.ones(1)).values()
    assert all(float(one.std) == 0.0 and float(one.leave_one_out) == 0.0 for one in resolved)


def test_a_problem_is_compiled_once_for_all_bounds_sigmas_and_numbers_and_anew_for_another_structure():
    def evaluate(problem):
        return transcribe(problem).program.evaluate(np.array([1.0]))

    first = evaluate(gain_problem())
    before = EVALUATE.compilations
    wider = evaluate(gain_problem().with_bound("response", 5.0))
    doubled = evaluate(gain_problem().with_sigmas("response", 2.0))
    other = evaluate(gain_problem(theta=al.Uniform(2.0, half_width=0.1)))
    assert EVALUATE.compilations == before
    # ... and the numbers are not those of the first problem.
    assert wider.constraints == pytest.approx(first.constraints)
    assert doubled.constraints == pytest.approx([1 + 2 * SPREAD])
    assert other.constraints == pytest.approx([2 + 0.1 / np.sqrt(3.0)])
    transcribe(gain_problem(expansion=al.Expansion(2, points=17)))
    assert EVALUATE.compilations == before + 1


def test_a_problem_whose_numbers_were_changed_in_place_is_transcribed_anew():
    weighted = algebraic(lambda a, weights: {"y": weights[0] * a})
    problem = al.Problem(weighted(al.Decision(1.0, 0.5, 2.0), np.array([1.0])), minimize=al.output("y").mean)
    assert al.solve(problem).objective == pytest.approx(0.5)
    problem.system.weights[...] = 3.0
    assert al.solve(problem).objective == pytest.approx(1.5)


@algebraic
def binomial(a, b):
    """What is left of (a + b)² - a² - 2 a b - b² is rounding."""
    return {"left": (a + b) ** 2 - a**2 - 2 * a * b - b**2, "a": a}


def test_a_limit_of_zero_on_rounding_neither_leads_a_search_nor_holds_a_design():
    limit = al.output("left").at_least(0.0)
    problem = al.Problem(binomial(al.Decision(0.6, 0.1, 0.9), 1 / 3), minimize=al.value("a"), subject_to=[limit])
    with pytest.warns(al.AleatorWarning, match="'left' is taken to hold: its values, .* count as rounding"):
        assert al.solve(problem).decisions["a"] == pytest.approx(0.1)
