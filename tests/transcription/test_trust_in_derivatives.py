"""Derivatives by distribution parameters carry a figure of trust: how well their own expansions are resolved."""

import warnings
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from tiny_models import ONE_STEP

MEAN, WIDTH = 0.3, 0.8


class Response(al.System):
    """Outputs of one uncertain number: a smooth one, one whose derivative has a kink, and a path that grows."""

    states = ("nothing",)
    a: Any
    gain: Any = 1.0

    def rhs(self, t, z):
        return (0.0 * z.nothing,)

    def outputs(self, t, z):
        powers = {"smooth": jnp.exp(2 * self.a), "kink": self.gain * jnp.abs(self.a + 0.1) * (self.a + 0.1)}
        return powers | {"path": t * powers["smooth"]}


def solved(output, order, *limits):
    """A design whose mean and half width are decided, in bounds so narrow that they stay where they are."""
    distribution = al.Uniform(
        al.Decision(MEAN, MEAN - 0.01, MEAN + 0.01), half_width=al.Decision(WIDTH, WIDTH - 0.01, WIDTH + 0.01)
    )
    return solution_of(
        al.Problem(
            Response(distribution),
            grid=ONE_STEP,
            minimize=al.terminal(output).mean,
            subject_to=list(limits),
            expansion=al.Expansion(order),
        )
    )


def solution_of(problem):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return al.solve(problem)


def missed(tangent, solution, order):
    """The rms error of the best polynomial for a tangent, over its standard deviation, by Gauss-Legendre nodes."""
    mean, width = solution.decisions["a.mean"], solution.decisions["a.half_width"]
    nodes, weights = np.polynomial.legendre.leggauss(80)
    values = tangent(nodes, mean + width * nodes)
    basis = np.polynomial.legendre.legvander(nodes, order) * np.sqrt(2 * np.arange(order + 1) + 1)
    coefficients = basis.T @ (weights / 2 * values)
    return np.sqrt(weights / 2 @ (values - basis @ coefficients) ** 2 / np.sum(coefficients[1:] ** 2))


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_the_figure_is_the_error_of_the_derivatives_own_expansion(order):
    solution = solved("smooth", order)
    errors = solution.certificate.expansion.tangents["smooth(t_f)"]
    exact = {
        "a.mean": missed(lambda _, a: 2 * np.exp(2 * a), solution, order),
        "a.half_width": missed(lambda germ, a: 2 * germ * np.exp(2 * a), solution, order),
    }
    assert set(errors) == set(exact)
    for name, error in errors.items():
        # Prediction from others is harder than the best fit, by the few points there are.
        assert exact[name] <= error <= 4 * exact[name]


def test_a_kink_in_the_slope_spoils_the_derivatives_before_the_values_and_that_is_said():
    solution = solved("kink", 5)
    quality = solution.certificate.expansion
    assert quality.worst <= quality.tolerance < quality.worst_tangent.error
    assert "not resolved, so shadow prices" in str(solution)
    assert "not resolved" not in str(solved("smooth", 5))


def test_paths_are_told_too_and_decisions_that_are_no_parameters_are_not():
    solution = solved("smooth", 4, al.path("path").mean <= 100.0)
    errors = solution.certificate.expansion.tangents
    assert errors["path(t)"] == pytest.approx(errors["smooth(t_f)"], rel=1e-6)
    distribution = al.Uniform(MEAN, half_width=WIDTH)
    problem = al.Problem(
        Response(distribution, gain=al.Decision(1.0, 0.5, 2.0)), grid=ONE_STEP, minimize=al.terminal("smooth").std
    )
    assert solution_of(problem).certificate.expansion.worst_tangent is None


def test_nothing_uncertain_has_no_such_figure():
    problem = al.deterministic(solved("smooth", 4).problem)
    quality = solution_of(problem).certificate.expansion
    assert quality.worst_tangent is None
    assert "by distribution parameters" not in str(solution_of(problem))
