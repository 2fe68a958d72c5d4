"""Fresh points, by which expansions are checked: what is constant at all collocation points does not pass unseen."""

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from zoo import cases

UNIT = {"x": al.Uniform.bounds(0.0, 1.0)}
RIPPLE_STD = np.sqrt(1 / 12 + 2.5**2 / 2)


def rippled(waves):
    return lambda at: at["x"] + 5.0 * jnp.cos(jnp.pi * waves * at["x"]) ** 2


def test_a_ripple_of_the_pitch_of_the_points_is_told_and_elements_have_its_closed_form():
    with pytest.warns(al.ExpansionWarning, match="does not resolve the output"):
        expanded = al.expand(rippled(12.0), UNIT)
    # By the collocation points all is well.
    assert float(expanded.std) == pytest.approx(np.sqrt(1 / 12))
    assert float(expanded.leave_one_out) < 1e-12
    assert float(expanded.error) == float(expanded.fresh_error) > 0.9
    assert "error at fresh points" in str(expanded)
    piecewise = al.expand(rippled(12.0), UNIT, al.MultiElement(error=1e-3))
    assert float(piecewise.std) == pytest.approx(RIPPLE_STD, rel=1e-5)


def test_what_vanishes_at_all_nodes_of_a_gauss_grid_is_told():
    def legendre(at):
        return at["x"] + (35 * at["x"] ** 4 - 30 * at["x"] ** 2 + 3) / 8

    expansion = al.Expansion(3, points=al.points.GaussPoints(4))
    with pytest.warns(al.ExpansionWarning, match="does not resolve the output"):
        expanded = al.expand(legendre, {"x": al.Uniform.bounds(-1.0, 1.0)}, expansion)
    # The mean square of the fourth polynomial is 1/9, and the variance of the first 1/3.
    assert float(expanded.std) == pytest.approx(np.sqrt(1 / 3))
    assert float(expanded.fresh_error) == pytest.approx(np.sqrt(1 / 9 / (1 / 3 + 1 / 9)), rel=0.5)


@pytest.mark.parametrize(("centre", "width"), cases([(0.2345, 1e-3), (0.5012, 3e-3), (0.777, 1e-2)]))
def test_elements_resolve_a_narrow_spike_to_its_closed_form(centre, width):
    def spiked(at):
        return at["x"] + 30.0 * jnp.exp(-(((at["x"] - at["centre"]) / at["width"]) ** 2))

    model = UNIT | {"centre": centre, "width": width}
    expanded = al.expand(spiked, model, al.MultiElement(error=1e-3))
    area = 30.0 * width * np.sqrt(np.pi)
    square = 1 / 3 + 900.0 * width * np.sqrt(np.pi / 2) + 2 * centre * area
    assert float(expanded.mean) == pytest.approx(0.5 + area, rel=1e-4)
    assert float(expanded.std) == pytest.approx(np.sqrt(square - (0.5 + area) ** 2), rel=1e-4)


@pytest.mark.parametrize("order", [2, 4])
def test_a_called_function_is_called_twice_more_and_what_the_basis_holds_is_exact_at_fresh_points(order):
    calls = []

    def square(at):
        calls.append(at["x"])
        return at["x"] ** 2

    expanded = al.expand(square, UNIT, al.Expansion(order), traced=False)
    assert len(calls) == 3 * (order + 1) + 2
    assert float(expanded.fresh_error) < 1e-12
    constant = al.expand(lambda at: 0.0 * at["x"] + 3.0, UNIT, al.Expansion(order), traced=False)
    assert float(constant.fresh_error) == 0.0
