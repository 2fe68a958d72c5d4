"""Evidence at every design of a front, against the normal distribution's tables."""

import warnings

import jax.numpy as jnp
import pytest
from scipy.stats import norm

import aleator as al
from zoo import MASS, STRESS, Bar


def bar():
    """Wide enough for a load that is normal: a margin is broken as often as its tables say."""
    strong = STRESS.at_most(0.5, sigmas=1.5).named("strong")
    return al.Problem(Bar(al.Decision(4.0, 0.1, 10.0), al.Normal(1.0, 0.2)), minimize=MASS.mean, subject_to=[strong])


def test_every_point_along_a_bound_has_the_share_of_its_normal_distribution():
    found = al.validate_all(al.pareto(bar(), "strong", [0.5, 0.4, 0.3]), 20_000)
    assert len(found.evidence) == 3
    for one in found.evidence:
        share = one.violations["strong"]
        assert share.lower <= norm.cdf(-1.5) <= share.upper
    assert found.agrees
    assert str(found).count(" to ") == 3


def test_a_trade_off_is_counted_against_the_problems_own_limits_alone():
    front = al.trade_off(bar(), {"mass": MASS.mean, "stress": STRESS.mean}, 3)
    found = al.validate_all(front, 5000)
    for one in found.evidence:
        assert set(one.violations) == {"strong"}
    # The lightest is as light as its limit lets it be.
    assert (
        found.evidence[0].violations["strong"].lower <= norm.cdf(-1.5) <= found.evidence[0].violations["strong"].upper
    )


class Root(al.AlgebraicSystem):
    """An output that some systems do not have where `a` is small."""

    a: al.Number
    off: al.Number

    def outputs(self):
        return {"x": jnp.sqrt(self.a - self.off)}


def least(bound):
    """The smallest `a` above a bound; two points of collocation are too few to see the end of the model."""
    root = Root(al.Decision(3.0, bound, 9.0), al.Normal(0.0, 0.2))
    with warnings.catch_warnings(action="ignore"):
        return al.solve(al.Problem(root, minimize=al.output("x").mean, expansion=al.Expansion(order=1)))


def test_designs_that_cannot_be_simulated_are_told_and_others_kept():
    found = al.validate_all([least(2.5), least(0.5)], 5000)
    assert found.evidence[0] is not None
    assert found.evidence[1] is None
    assert "not finite" in found.refused[1]
    assert not found.agrees
    assert "not finite" in str(found)


def test_ctrl_c_keeps_what_was_validated():
    def stop(_stage, done, _total):
        if done == 1:
            raise KeyboardInterrupt

    found = al.validate_all(al.pareto(bar(), "strong", [0.5, 0.4, 0.3]), 500, progress=stop)
    assert found.interrupted
    assert len(found.designs) == len(found.evidence) == 1


def test_what_is_no_design_is_refused():
    with pytest.raises(al.ProblemError, match=r"what al.pareto, al.trade_off or al.multistart gives"):
        al.validate_all([1.0])  # type: ignore[list-item]
    with pytest.raises(al.ProblemError, match="at least one solved design"):
        al.validate_all([])
