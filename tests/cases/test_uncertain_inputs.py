"""Inputs on which other tools failed: far in a tail, correlated and not normal, outside of the model."""

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al

pytestmark = pytest.mark.slow


# --- The ratio of correlated lognormals (Dakota user's manual, logratio_uq_reliability) ------------------------------


# The logarithm of the ratio is normal.
BELOW = {0.4: 0.04762408596, 0.5: 0.10346525475, 0.55: 0.13818404972, 0.6: 0.17616275822, 0.7: 0.25803428381}
MEAN, STD = 1.1627906976744187, 0.6899594819996258


def ratio(at):
    return at["x1"] / at["x2"]


@pytest.fixture(scope="module")
def lognormals():
    return al.correlated({name: al.LogNormal(mean=1.0, std=0.5) for name in ("x1", "x2")}, {("x1", "x2"): 0.3})


def test_the_ratio_of_correlated_lognormals_has_the_moments_and_the_tail_of_a_lognormal(lognormals):
    # At order 4 the polynomial itself, sampled, is off by 2.5e-3 at 0.4.
    expanded = al.expand(ratio, lognormals, al.Expansion(order=5))
    assert expanded.mean == pytest.approx(MEAN, rel=1e-4)
    assert expanded.std == pytest.approx(STD, rel=1e-3)
    for level, probability in BELOW.items():
        assert expanded.probability(below=level) == pytest.approx(probability, abs=1e-3)
    with pytest.raises(al.ProblemError, match="correlated group"):
        expanded.sobol("x1")


# --- The height of a flood (Iooss and Lemaitre 2015; openturns/otbenchmark) -------------------------------------------


def gumbel(q):
    reduced = (q - 1013.0) / 558.0
    return np.exp(-reduced - np.exp(-reduced))


def river(least: float, **changed):
    """The inputs, with a friction coefficient from `least` on."""
    return {
        "Q": al.Density(gumbel, 0.0, np.inf),
        "Ks": al.TruncatedNormal(30.0, 7.5, lower=least),
        "Zv": al.Uniform.bounds(49.0, 51.0),
        "Zm": al.Uniform.bounds(54.0, 56.0),
        "Hd": al.Uniform.bounds(7.0, 9.0),
        "Zb": al.Triangular(55.0, 55.5, 56.0),
        "L": al.Triangular(4990.0, 5000.0, 5010.0),
        "B": al.Triangular(295.0, 300.0, 305.0),
    } | changed


def height(at):
    slope = (at["Zm"] - at["Zv"]) / at["L"]
    return (at["Q"] / (at["Ks"] * at["B"] * jnp.sqrt(slope))) ** 0.6 + at["Zv"] - at["Zb"] - at["Hd"]


def test_a_flood_over_a_bounded_friction_has_its_moments():
    expanded = al.expand(height, river(10.0), al.Expansion(order=4))
    assert expanded.mean == pytest.approx(-10.962525, rel=1e-3)
    assert expanded.std == pytest.approx(1.307230, rel=0.01)


def test_a_flood_whose_variance_is_infinite_is_not_called_resolved():
    with pytest.warns(al.ExpansionWarning, match="does not resolve the output"):
        expanded = al.expand(height, river(0.0), al.Expansion(order=4))
    assert expanded.mean == pytest.approx(-10.949307, rel=1e-3)


@pytest.mark.parametrize("analyse", [al.expand, al.references.monte_carlo])
def test_a_flow_that_may_be_negative_is_named_where_the_height_is_no_number(analyse):
    with pytest.raises(al.SimulationError, match=r"'height' is not finite at .* points: .*Q=-"):
        analyse(height, river(10.0, Q=al.Gumbel(1013.0, 558.0)))
