"""Adaptive index sets and sparse fits inside a problem: chosen once, at the initial decisions."""

import warnings
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.expansion import Adaptive, HyperbolicCross, Sparse
from aleator.transcription import transcribe
from aleator.transcription._discretisation import _collocated
from tiny_models import ONE_STEP


class Many(al.System):
    """Ten uncertain numbers, of which the first two matter: `y = gain exp(k_0 k_1) + small sum of all`."""

    states = ("nothing",)
    gain: Any
    k: list

    def rhs(self, t, z):
        return (0.0 * z.nothing,)

    def outputs(self, t, z):
        k = jnp.stack([jnp.asarray(one) for one in self.k])
        return {"y": self.gain * jnp.exp(k[0] * k[1]) + 0.01 * jnp.sum(k), "loss": (self.gain - 4.0) ** 2}


def many_problem(expansion, bound=3.0, gain=1.0):
    distributions = [al.Uniform(0.6, half_width=0.4) for _ in range(10)]
    return al.Problem(
        Many(al.Decision(gain, 0.1, 9.0), distributions),
        grid=ONE_STEP,
        minimize=al.terminal("loss").mean,
        subject_to=[al.terminal("y").at_most(bound, sigmas=1.0)],
        expansion=expansion,
    )


def exact_design(bound):
    """The gain at which mean + std of the response meet the bound, by a tensor Gauss rule in the two that matter."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    k, w = 0.6 + 0.4 * nodes, weights / 2
    grow, first = np.exp(np.outer(k, k)), np.add.outer(k, k)
    joint = np.outer(w, w)

    def end(gain):
        y = gain * grow + 0.01 * first
        mean = np.sum(joint * y)
        rest = 8 * 0.01**2 * 0.4**2 / 3
        return mean + 0.01 * 8 * 0.6 + np.sqrt(np.sum(joint * (y - mean) ** 2) + rest) - bound

    low, high = 0.1, 9.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if end(middle) < 0 else (low, middle)
    return low


ADAPTIVE = al.Expansion(index_set=Adaptive(error=1e-3, budget=800))
SPARSE = al.Expansion(6, index_set=HyperbolicCross(0.7), points=200, fit=Sparse())


@pytest.mark.parametrize("expansion", [ADAPTIVE, SPARSE], ids=["adaptive", "sparse"])
def test_a_chosen_expansion_gives_the_design_of_the_exact_moments(expansion):
    if expansion is SPARSE:
        pytest.importorskip("sklearn")
    solution = al.solve(many_problem(expansion))
    assert solution.decisions["gain"] == pytest.approx(exact_design(3.0), rel=1e-3)
    quality = solution.certificate.expansion
    assert 3 <= quality.order <= 20
    # All terms of that order in ten variables would be 286 at least.
    assert 11 <= quality.terms < 150
    assert quality.points < 800
    assert f"order {quality.order}, {quality.terms} terms, {quality.points} points" in str(solution)


def test_terms_are_chosen_once_for_all_bounds_and_margins():
    problem = many_problem(ADAPTIVE)
    first = transcribe(problem)
    before = _collocated.cache_info().misses
    front = al.pareto(problem, "y", [2.0, 2.5, 3.0, 4.0])
    margins = transcribe(problem.with_sigmas("y", 3.0))
    assert _collocated.cache_info().misses == before
    assert front.solved.all()
    assert margins.collocation is first.collocation


def test_terms_are_chosen_anew_for_another_model():
    first = transcribe(many_problem(ADAPTIVE))
    before = _collocated.cache_info().misses
    second = transcribe(many_problem(ADAPTIVE, gain=2.0))
    assert _collocated.cache_info().misses == before + 1
    assert second.collocation is not first.collocation


def test_a_deterministic_problem_has_no_terms_to_choose():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solution = al.solve(al.deterministic(many_problem(ADAPTIVE)))
    assert solution.certificate.expansion.points == 1
    assert solution.decisions["gain"] == pytest.approx((3.0 - 0.01 * 6) / np.exp(0.36), rel=1e-6)


def test_equal_expansions_of_one_germ_are_built_once():
    first, second = (transcribe(many_problem(al.Expansion(2), bound)) for bound in (3.0, 4.0))
    assert first.collocation is second.collocation
    assert transcribe(many_problem(al.Expansion(1))).collocation is not first.collocation
