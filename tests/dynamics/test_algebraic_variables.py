"""Systems with algebraic variables (index 1): solutions, derivatives, order, and what is told where there are none."""

import re
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq

import aleator as al
from aleator.dynamics import simulation_of


class Bent(al.System):
    """Two algebraic variables, one of them an array, and a state that both of them move; `push` is read by no rate."""

    states = ("x",)
    algebraic = ("y", "pair")

    def rhs(self, t, z):
        return (-z.y - 0.1 * z.pair[0] * z.pair[1],)

    def residual(self, t, z, push):
        first, second = z.pair
        return z.y + z.y**3 - z.x - push, jnp.stack([2.0 * first - z.y - 0.2 * second, second - first])

    def algebraic_guess(self, t, z):
        return {"pair": jnp.ones(2)}

    def outputs(self, t, z, push):
        return {"x": z.x, "y": z.y, "pair": z.pair}

    def initial(self):
        return {"x": 1.0}


PUSH = {"push": al.PowerSeries(start=(0.0, 1.0), end=(0.5, -1.0))}


def by_hand() -> tuple[float, float]:
    """The last state and `y`: Newton's method, signal and integrator are SciPy's."""
    push = CubicHermiteSpline([0.0, 2.0], [0.0, 0.5], [1.0, -1.0])

    def y_of(t, x):
        level = x + float(push(t))
        return brentq(lambda y: y + y**3 - level, -10.0, 10.0, xtol=1e-15, rtol=1e-15)

    def rates(t, state):
        y = y_of(t, state[0])
        return [-y - 0.1 * (y / 1.8) ** 2]

    x = solve_ivp(rates, (0.0, 2.0), [1.0], method="DOP853", rtol=1e-12, atol=1e-13).y[0, -1]
    return x, y_of(2.0, x)


def test_states_and_algebraic_variables_are_those_of_root_finding_and_integration_by_scipy():
    found = {name: np.asarray(values) for name, values in al.simulate(Bent(), al.Grid(2.0, 32), PUSH).items()}
    np.testing.assert_allclose([found["x"][-1], found["y"][-1]], by_hand(), rtol=0, atol=5e-7)
    np.testing.assert_allclose(found["pair"][-1], np.full(2, found["y"][-1] / 1.8), rtol=1e-12)


class Folded(al.System):
    """`y² = x`, while `x` falls through zero at one second."""

    states = ("x",)
    algebraic = ("y",)

    near: Any = 1.0

    def rhs(self, t, z):
        return (-1.0 + 0.0 * z.y,)

    def residual(self, t, z):
        return (z.y**2 - z.x,)

    def algebraic_guess(self, t, z):
        return {"y": self.near}

    def outputs(self, t, z):
        return {"y": z.y}

    def initial(self):
        return {"x": 1.0}


class IndexTwo(Folded):
    """The state is prescribed, and the algebraic variable follows only from its derivative."""

    def rhs(self, t, z):
        return (z.y,)

    def residual(self, t, z):
        return (z.x - jnp.cos(t),)


def test_the_guess_decides_between_solutions():
    found = al.simulate(Folded(near=-0.3), al.Grid(0.9, 3))["y"]
    np.testing.assert_allclose(found, -np.sqrt([1.0, 0.7, 0.4, 0.1]), rtol=1e-12)


@pytest.mark.slow
def test_where_solutions_meet_and_an_index_above_one_are_told():
    assert "index 1" in simulation_of(IndexTwo(), al.Grid(2.0, 8), None, None).explain()
    told = simulation_of(Folded(), al.Grid(2.0, 8), None, None).explain()
    assert re.match(r"Folded: its algebraic variables have no solution at about t = 1(\.0\d*)? s", told)
    assert "algebraic_guess" in told or "the Jacobian is singular there" in told


def changed(base=Folded, **parts: Any) -> Any:
    return type("Odd", (base,), parts)()


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (lambda: changed(algebraic=()), "writes residual and algebraic_guess, but names no algebraic variables"),
        (lambda: changed(initial=lambda self: {"x": 1.0, "y": 1.0}), r"initial names \['y'\], .* in algebraic_guess"),
    ],
)
def test_what_does_not_fit_together_is_refused_in_words(system, message):
    with pytest.raises(al.ProblemError, match=message):
        al.simulate(system(), al.Grid(1.0, 2))
