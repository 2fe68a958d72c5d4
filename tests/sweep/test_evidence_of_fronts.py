"""Evidence at every design of a front, against the normal distribution's tables."""

import warnings

import jax.numpy as jnp
import pytest
from scipy.stats import norm

import aleator as al

X, Y = al.output("x"), al.output("y")


class Pair(al.AlgebraicSystem):
    """Two decided numbers, both moved by one disturbance."""

    unknowns = ()
    a: al.Number
    b: al.Number
    off: al.Number

    def outputs(self):
        return {"x": self.a + self.off, "y": self.b + self.off}


def pair(*limits, minimize=None):
    decisions = (al.Decision(0.5, -3.0, 3.0) for _ in "ab")
    objective = X.mean**2 + Y.mean**2 if minimize is None else minimize
    return al.Problem(Pair(*decisions, al.Normal(0.0, 0.1)), minimize=objective, subject_to=limits)


def test_every_point_along_a_bound_has_the_share_of_its_normal_distribution():
    front = al.pareto(pair(X.at_least(0.2, sigmas=1.5).named("low")), "low", [0.2, 0.5, 1.0])
    found = al.validate_all(front, 20_000)
    assert len(found.evidence) == 3
    for one in found.evidence:
        share = one.violations["low"]
        assert share.lower <= norm.cdf(-1.5) <= share.upper
    assert found.agrees
    assert str(found).count(" to ") == 3


def test_a_trade_off_is_counted_against_the_problems_own_limits_alone():
    limit = (X.at_least(0.3, probability=0.9)).named("low")
    front = al.trade_off(pair(limit), {"x": X.mean + 0.1 * Y.mean**2, "y": Y.mean**2 - 0.5 * X.mean}, 4)
    found = al.validate_all(front, 5000)
    for one in found.evidence:
        assert set(one.violations) == {"low"}
    assert found.evidence[0].violations["low"].lower <= 0.1 <= found.evidence[0].violations["low"].upper


class Root(al.AlgebraicSystem):
    """An output that some systems do not have where `a` is small."""

    unknowns = ()
    a: al.Number
    off: al.Number

    def outputs(self):
        return {"x": jnp.sqrt(self.a - self.off)}


def least(bound):
    """The smallest `a` above a bound; two points of collocation are too few to see the end of the model."""
    root = Root(al.Decision(3.0, bound, 9.0), al.Normal(0.0, 0.2))
    with warnings.catch_warnings(action="ignore"):
        return al.solve(al.Problem(root, minimize=X.mean, expansion=al.Expansion(order=1)))


def test_designs_that_cannot_be_simulated_are_told_and_others_kept():
    found = al.validate_all([least(2.5), least(0.5)], 5000)
    assert found.evidence[0] is not None
    assert found.evidence[1] is None
    assert "not finite" in found.refused[1]
    assert not found.agrees
    assert "not finite" in str(found)


@pytest.mark.usefixtures("python_interrupts")
def test_ctrl_c_keeps_what_was_validated():
    def stop(_stage, done, _total):
        if done == 1:
            raise KeyboardInterrupt

    front = al.pareto(pair(X.at_least(0.2, sigmas=1.5).named("low")), "low", [0.2, 0.5, 1.0])
    found = al.validate_all(front, 500, progress=stop)
    assert found.interrupted
    assert len(found.designs) == len(found.evidence) == 1


def test_what_is_no_design_is_refused():
    with pytest.raises(al.ProblemError, match=r"what al.pareto, al.trade_off or al.multistart gives"):
        al.validate_all([1.0])  # type: ignore[list-item]
    with pytest.raises(al.ProblemError, match="at least one solved design"):
        al.validate_all([])
