"""Rare events of 3 to 100 inputs (the TNO black-box reliability benchmark, as in openturns/otbenchmark)."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import aleator as al

pytestmark = pytest.mark.slow


class Margin(al.AlgebraicSystem):
    """A limit state of inputs and a threshold; it fails below zero."""

    x: dict
    threshold: al.Number
    function: Callable = eqx.field(static=True)

    def outputs(self):
        return {"g": self.function(self.x, self.threshold)}


def normals(count: int):
    return {f"x{i}": al.Normal(0.0, 1.0) for i in range(1, count + 1)}


def excess(x, threshold):
    return sum(x.values()) - threshold


def shortfall(x, threshold):
    return threshold - sum(x.values())


def switched(x, threshold):
    return jnp.where(x["x3"] <= threshold, x["x1"] - x["x2"] - x["x3"], x["x3"] - x["x2"])


def paraboloid(x, threshold=4.5):
    return 0.1 * sum(x[f"x{i}"] ** 2 for i in range(2, 101)) - x["x1"] - threshold


SWITCHED = {"x1": al.Normal(10.0, 0.5), "x2": al.Normal(0.0, 1.0), "x3": al.Normal(4.0, 1.0)}
# Probabilities in closed form, or by quadrature in one variable.
EVENTS = {
    "RP54": (excess, {f"x{i}": al.Exponential(mean=1.0) for i in range(1, 21)}, 8.951, stats.gamma.cdf(8.951, 20)),
    "RP107": (shortfall, normals(10), 5 * np.sqrt(10), stats.norm.sf(5.0)),
    "RP77": (switched, SWITCHED, 5.0, 2.690843952e-7),
}
OF_PARABOLOID = 3.76943612e-4


def as_it_is(function, x, threshold) -> al.Solution:
    """The design at its threshold, whatever the expansion makes of it: only samples count here."""
    problem = al.Problem(
        Margin(x, al.Decision(threshold, threshold, threshold + 1), function),
        minimize=al.value("threshold"),
        subject_to=[al.output("g").at_least(0.0)],
        expansion=al.Expansion(order=1, tolerance=2.0),
    )
    return al.solve(problem)


@pytest.mark.parametrize("event", EVENTS)
def test_rare_events_are_estimated_by_twenty_thousand_samples(event):
    function, x, threshold, probability = EVENTS[event]
    solution = as_it_is(function, x, threshold)
    shares = [al.rare_violation(solution, seed=seed) for seed in range(4)]
    assert [share.estimate for share in shares] == pytest.approx([probability] * 4, rel=0.2)
    # Of four intervals that hold in 95 % of all cases, more than one misses once in seventy times.
    assert sum(not share.lower <= probability <= share.upper for share in shares) <= 1


# The error of the integral is told: these tails are known to some percent.
@pytest.mark.filterwarnings("ignore:P.output:aleator.ExpansionWarning")
def test_a_paraboloid_of_a_hundred_inputs_is_expanded_exactly():
    expanded = al.expand(paraboloid, normals(100), al.Expansion(order=2, fit=al.fits.Sparse()))
    assert (expanded.mean, expanded.std) == pytest.approx((5.4, 1.72626765), rel=1e-6)
    assert expanded.skewness == pytest.approx(0.153957477, rel=1e-6)
    assert expanded.probability(below=0.0) == pytest.approx(OF_PARABOLOID, rel=0.2)
