"""What a solution says of its expansion: where it fails, of its derivatives too, and when nothing can be said."""

import warnings

import jax.numpy as jnp
import numpy as np
import pytest
import scipy
from scipy import optimize

import aleator as al
from aleator.expansion import Adaptive, HyperbolicCross, Sparse, collocate
from aleator.transcription import transcribe
from aleator.transcription._discretised import _collocated
from aleator.uncertainty import LegendreGerm
from zoo import algebraic, cases

TIMES, ORDER = np.linspace(0.0, 30.0, 301), 4


class Phase(al.System):
    """`x = cos(w t)`, no dynamics: the spread of `w` bends `x` over the germ more and more. Time runs at a pace."""

    states = ("nothing",)
    w: al.Number
    gain: al.Number
    pace: al.Number = 1.0

    def rhs(self, t, z):
        return (0.0 * z.nothing,)

    def outputs(self, t, z):
        return {"x": jnp.cos(self.w * self.pace * t), "loss": (self.gain - 1.0) ** 2}


def phase_problem(pace=0.2, **expansion):
    return al.Problem(
        Phase(al.Uniform(2.0, half_width=0.2), al.Decision(0.5, 0.0, 3.0), pace),
        grid=al.Grid(30.0, 300),
        minimize=al.terminal("loss").mean,
        subject_to=[al.path("x").at_most(5.0, sigmas=1.0)],
        expansion=al.Expansion(**({"order": ORDER} | expansion)),
    )


def lost_variance():
    """The part of the variance beyond the order at each instant, relative to the largest variance so far, by Gauss."""
    nodes, weights = LegendreGerm().gauss(60)
    samples = np.cos(np.outer(2.0 + 0.2 * nodes, TIMES))
    energy = (LegendreGerm().polynomials(40, nodes).T * weights @ samples) ** 2
    variance = np.maximum.accumulate(energy[1:].sum(axis=0))
    return energy[ORDER + 1 :].sum(axis=0)[1:] / variance[1:]


@pytest.mark.slow
def test_a_long_simulation_is_followed_until_an_instant_that_the_warning_names():
    expected = float(TIMES[1 + np.argmax(lost_variance() > 0.05**2)])
    with pytest.warns(al.ExpansionWarning, match=r"order 4 does not resolve x\(t\) .* from t = 1\d.* s on"):
        solution = al.solve(phase_problem(pace=1.0), throw=False)
    assert "expansion is too coarse" in solution.verdict
    # A sample is predicted from the others a little worse than the best approximation.
    assert 0.75 * expected <= solution.certificate.expansion.unresolved_from["x(t)"] <= expected
    assert solution.certificate.expansion.unresolved == ("x(t)",)


def test_what_is_slow_enough_is_resolved_and_the_corner_is_named_in_which_no_point_lies():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solution = al.solve(phase_problem())
    quality = solution.certificate.expansion
    assert (quality.unresolved_from, quality.unresolved) == ({}, ())
    points = collocate(solution.problem.placements.germs, solution.problem.expansion).collocation.points
    levels = np.sort((1 + np.asarray(points)[:, 0]) / 2)
    assert quality.unseen.probability == pytest.approx(max(levels[0], 1 - levels[-1]), rel=1e-9)
    assert "the largest corner without a point (w " in str(solution)


# --- Derivatives by the parameters of distributions ------------------------------------------------------------------

MEAN, WIDTH = 0.3, 0.8


# A smooth function of an uncertain number, and one whose derivative has a kink.
Bent = algebraic(lambda a: {"smooth": jnp.exp(2 * a), "kink": jnp.abs(a + 0.1) * (a + 0.1)})


def bent_problem(output, order, points=None):
    """A design whose mean and half width are decided, in bounds so narrow that they stay where they are."""
    mean, width = (al.Decision(x, x - 0.01, x + 0.01) for x in (MEAN, WIDTH))
    return al.Problem(
        Bent(al.Uniform(mean, half_width=width)),
        minimize=al.output(output).mean,
        expansion=al.Expansion(order, points=points),
    )


def missed(tangent, solution, order):
    """The rms error of the best polynomial for a tangent, over its standard deviation, by Gauss-Legendre nodes."""
    mean, width = solution.decisions["a.mean"], solution.decisions["a.half_width"]
    nodes, weights = np.polynomial.legendre.leggauss(80)
    values = tangent(nodes, mean + width * nodes)
    basis = np.polynomial.legendre.legvander(nodes, order) * np.sqrt(2 * np.arange(order + 1) + 1)
    coefficients = basis.T @ (weights / 2 * values)
    return np.sqrt(weights / 2 @ (values - basis @ coefficients) ** 2 / np.sum(coefficients[1:] ** 2))


@pytest.mark.filterwarnings("ignore")
def test_the_figure_of_derivatives_is_the_error_of_their_own_expansion():
    order = 3
    solution = al.solve(bent_problem("smooth", order))
    errors = solution.certificate.expansion.tangents["smooth"]
    exact = {
        "a.mean": missed(lambda _, a: 2 * np.exp(2 * a), solution, order),
        "a.half_width": missed(lambda germ, a: 2 * germ * np.exp(2 * a), solution, order),
    }
    assert set(errors) == set(exact)
    for name, error in errors.items():
        # Prediction from others is harder than the best fit, by the few points there are.
        assert exact[name] <= error <= 4 * exact[name]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_an_optimum_that_follows_from_derivatives_that_are_not_resolved_is_no_answer():
    system = algebraic(lambda x: {"y": (x - 0.45) ** 2})(al.Triangular(0.0, al.Decision(0.3, 0.01, 0.99), 1.0))
    solution = al.solve(al.Problem(system, minimize=al.output("y").std), throw=False)
    levels = (np.arange(10**4) + 0.5) / 10**4

    def spread(mode):
        return np.std((scipy.stats.triang(mode).ppf(levels) - 0.45) ** 2)

    least = scipy.optimize.minimize_scalar(spread, bounds=(0.01, 0.99), method="bounded").x
    assert abs(solution.decisions["x.mode"] - least) > 0.03
    assert not solution.ok
    assert "the derivative of y by x.mode" in solution.why()


def test_as_many_points_as_terms_leave_nothing_to_check_by():
    with pytest.warns(al.ExpansionWarning, match="5 points for 5 terms leave nothing to check the expansion"):
        solution = al.solve(bent_problem("smooth", 4, points=5))
    assert not solution.certificate.expansion.can_be_checked


def test_the_rounding_of_a_derivative_that_vanishes_says_nothing_of_the_expansion():
    inert = algebraic(lambda h, e: {"w": h * jnp.exp(e) / jnp.exp(e), "e": e})
    problem = al.Problem(
        inert(al.Uniform(2.0, half_width=0.2), al.Uniform(al.Decision(0.6, 0.3, 0.9), half_width=0.05)),
        minimize=-1 * al.value("e.mean"),
        subject_to=[al.output("w").at_most(2.3, sigmas=2), al.output("e").at_most(0.8, sigmas=2)],
    )
    solution = al.solve(problem)
    assert solution.ok
    assert solution.certificate.expansion.tangents["w"]["e.mean"] == 0.0
    assert solution.decisions["e.mean"] == pytest.approx(0.8 - 2 * 0.05 / np.sqrt(3), rel=1e-6)


# --- Adaptive index sets and sparse fits inside a problem -------------------------------------------------------------


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
