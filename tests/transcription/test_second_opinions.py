"""Fresh simulations at the answer: they agree where an expansion is right, and sound the alarm where it is not."""

import warnings
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import aleator as al
from aleator.certification._fresh_systems import fresh_systems
from aleator.transcription._discretisation import RESPOND
from aleator.transcription.sequential import EVALUATE
from tiny_models import LOSS, ONE_STEP, gain_problem, oscillator_problem

Y, BOUND = al.terminal("y"), 2.0


class Comb(al.System):
    """A line, and teeth between the twelve points of order 3, of which none knows: `E[y] = gain teeth / 2`."""

    states = ("nothing",)
    gain: Any
    theta: Any
    teeth: Any

    def rhs(self, t, z):
        return (0.0 * z.nothing,)

    def outputs(self, t, z):
        level = self.theta / 2
        y = self.gain * (self.theta + self.teeth * jnp.cos(12 * jnp.pi * level) ** 2)
        return {"y": y, "loss": (self.gain - 3.0) ** 2}


def comb_problem(teeth, limit=None):
    return al.Problem(
        Comb(al.Decision(0.5, 0.0, 10.0), al.Uniform(1.0, half_width=1.0), teeth),
        grid=ONE_STEP,
        minimize=LOSS.mean,
        subject_to=[Y.mean <= BOUND if limit is None else limit],
        expansion=al.Expansion(3),
    )


def test_a_smooth_design_is_confirmed_and_told_so():
    for problem in (gain_problem(), oscillator_problem()):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            solution = al.solve(problem)
        assert solution.certificate.opinion is not None
        assert solution.certificate.opinion.agrees
        assert "32 fresh simulations agree" in str(solution)


def test_a_limit_that_only_the_expansion_meets_is_no_solution():
    with pytest.warns(al.ExpansionWarning, match="fresh simulations disagree"):
        solution = al.solve(comb_problem(0.6), throw=False)
    # No point sees the teeth: by the expansion all is well.
    assert solution.certificate.expansion.worst < 1e-6
    assert solution.decisions["gain"] == pytest.approx(BOUND, rel=1e-6)
    assert not solution.ok
    assert "contradict" in solution.status.value
    with pytest.raises(al.SolveError, match=r"fresh simulations contradict it: 'y' is broken by .*Raise the order"):
        al.solve(comb_problem(0.6))


def test_the_correction_is_that_of_the_closed_form():
    with pytest.warns(al.ExpansionWarning, match="fresh simulations disagree"):
        solution = al.solve(comb_problem(0.6, Y.mean <= 50.0))
    (told,) = (one for one in solution.certificate.opinion.contradictions if one.startswith("μ[y(t_f)]"))
    by, error = (float(part) for part in told.split(" differs by ")[1].split(" in ")[0].split(" ± "))
    # The teeth's mean, and its standard error over 32 systems: cos² spreads by 1 / sqrt(8).
    gain = solution.decisions["gain"]
    assert error == pytest.approx(gain * 0.6 / np.sqrt(8 * 32), rel=0.3)
    assert abs(by - gain * 0.6 / 2) < 4 * error


def test_small_teeth_are_warned_of_and_leave_a_design_a_solution():
    with pytest.warns(al.ExpansionWarning, match="fresh simulations disagree"):
        solution = al.solve(comb_problem(0.04))
    assert solution.ok
    assert not solution.certificate.opinion.agrees
    assert solution.certificate.opinion.broken == ""


def test_limits_over_time_and_norms_are_judged_with_the_rest():
    limits = (
        al.path("y").std <= 5.0,
        al.objectives.norm(Y.mean, Y.skewness) <= 50.0,
        al.time_integral(al.path("y").mean) <= 9.0,
    )
    with pytest.warns(al.ExpansionWarning, match="fresh simulations disagree"):
        solution = al.solve(comb_problem(0.6, limits))
    told = " ".join(solution.certificate.opinion.contradictions)
    assert "‖μ[y(t_f)], Skew[y(t_f)]‖" in told
    assert "∫μ[y(t)] dt" in told
    # Far from their bounds, they break nothing.
    assert solution.ok


class Square(al.AlgebraicSystem):
    x: al.Number

    def outputs(self):
        return {"y": self.x**2}


@pytest.mark.parametrize("alpha", [0.466, 0.4])
def test_a_spread_that_lies_in_one_tail_is_wrong_by_no_more_than_is_told(alpha):
    # The least spread is at the lower bound, where `y` is no polynomial of its germ, whose shape is that of the start:
    # one point in a hundred holds much of the spread.
    shaped = al.Beta(alpha=al.Decision(0.65, alpha, 5.0), beta=8.0, lower=0.0, upper=1.0)
    problem = al.Problem(Square(shaped), minimize=al.output("y").std, expansion=al.Expansion(order=4))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", al.ExpansionWarning)
        solution = al.solve(problem, throw=False)
    moment = scipy.stats.beta(alpha, 8.0).moment
    exact = np.sqrt(moment(4) - moment(2) ** 2)
    wrong = abs(solution.objective / exact - 1)
    assert solution.decisions["x.alpha"] == pytest.approx(alpha)
    assert wrong > 0.05
    assert max(solution.certificate.opinion.misses.values()) > wrong
    assert not solution.certificate.opinion.agrees


@pytest.mark.parametrize(
    "germs", [(al.Uniform(0.5, half_width=0.5),), (al.Normal(0.0, 1.0), al.Uniform(0.0, half_width=1.0))]
)
def test_weights_of_fresh_systems_give_the_moments_of_all(germs):
    basis = [one.germ() for one in germs]
    several = [fresh_systems(basis, 32, np.random.default_rng(seed)) for seed in range(400)]
    weights, first = (
        np.array(part) for part in ([one.weights for one in several], [one.points[:, 0] for one in several])
    )
    assert weights.max() <= 2.0
    for power, exact in ((0, 1.0), (1, 0.0), (2, 1.0 if len(germs) == 2 else 1 / 3)):
        means = np.mean(weights * first**power, axis=1)
        assert abs(means.mean() - exact) < 4 * means.std() / np.sqrt(400)
    # Each of them has systems at which random ones hardly ever arrive.
    beyond = scipy.stats.norm.ppf(0.999) if len(germs) == 2 else 0.998
    assert all((one.points[:, 0] > beyond).any() and (one.points[:, 0] < -beyond).any() for one in several)


def test_nothing_is_asked_where_nothing_is_uncertain():
    assert al.solve(gain_problem(theta=1.0)).certificate.opinion is None


def test_another_bound_and_another_tolerance_compile_nothing_for_it():
    al.solve(gain_problem(2.0))
    before = RESPOND.compilations, EVALUATE.compilations
    al.solve(gain_problem(1.9, expansion=al.Expansion(tolerance=0.5)))
    assert (RESPOND.compilations, EVALUATE.compilations) == before
