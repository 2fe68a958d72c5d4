"""Adaptive index sets and sparse fits inside a problem: chosen once, at the initial decisions."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

import aleator as al
from aleator.expansion import Adaptive, HyperbolicCross, Sparse
from aleator.transcription import transcribe
from aleator.transcription._discretised import _collocated
from zoo import algebraic, cases

# Ten uncertain numbers, of which the first two matter.
Many = algebraic(lambda gain, k: {"y": gain * jnp.exp(k[0] * k[1]) + 0.01 * sum(k), "loss": (gain - 4.0) ** 2})


def many_problem(expansion, gain=1.0):
    return al.Problem(
        Many(al.Decision(gain, 0.1, 9.0), [al.Uniform(0.6, half_width=0.4) for _ in range(10)]),
        minimize=al.output("loss").mean,
        subject_to=[al.output("y").at_most(3.0, sigmas=1.0)],
        expansion=expansion,
    )


def exact_design():
    """The gain at which mean + std of the response are 3, by a tensor Gauss rule in the two that matter."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    k, joint = 0.6 + 0.4 * nodes, np.outer(weights, weights) / 4
    grown, first = np.exp(np.outer(k, k)), np.add.outer(k, k)

    def end(gain):
        y = gain * grown + 0.01 * first
        mean, rest = np.sum(joint * y), 8 * 0.01**2 * 0.4**2 / 3
        return mean + 0.01 * 8 * 0.6 + np.sqrt(np.sum(joint * (y - mean) ** 2) + rest) - 3.0

    return optimize.brentq(end, 0.1, 9.0)


ADAPTIVE = al.Expansion(index_set=Adaptive(error=1e-3, budget=800))
SPARSE = al.Expansion(6, index_set=HyperbolicCross(0.7), points=200, fit=Sparse())


@pytest.mark.parametrize("expansion", cases([ADAPTIVE, SPARSE]), ids=["adaptive", "sparse"])
def test_a_chosen_expansion_gives_the_design_of_the_exact_moments(expansion):
    solution = al.solve(many_problem(expansion))
    assert solution.decisions["gain"] == pytest.approx(exact_design(), rel=1e-3)
    quality = solution.certificate.expansion
    assert 3 <= quality.order <= 20
    # All terms of that order in ten variables would be 286 at least.
    assert 11 <= quality.terms < 150
    assert quality.points < 800
    assert f"order {quality.order}, {quality.terms} terms, {quality.points} points" in str(solution)


def test_terms_are_chosen_once_for_all_bounds_and_margins_and_anew_for_another_model():
    problem = many_problem(ADAPTIVE)
    first = transcribe(problem)
    before = _collocated.cache_info().misses
    for other in (problem.with_sigmas("y", 3.0), problem.with_bound("y", 2.0)):
        assert transcribe(other).collocation is first.collocation
    assert _collocated.cache_info().misses == before
    assert transcribe(many_problem(ADAPTIVE, gain=2.0)).collocation is not first.collocation
    assert _collocated.cache_info().misses == before + 1
