"""Systems with algebraic variables (index 1): solutions, derivatives, order, and what is told where there are none."""

import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import aleator as al
from aleator.dynamics import simulation_of
from compiling import compiled
from stirred_tanks import ExplicitTank, Tank


class Robertson(al.System):
    """Robertson's reactions, with the last species from the balance of mass: stiff."""

    states = ("a", "b")
    algebraic = ("c",)

    slow: Any = 0.04

    def rhs(self, t, z):
        exchange = 1e4 * z.b * z.c
        return exchange - self.slow * z.a, self.slow * z.a - exchange - 3e7 * z.b**2

    def residual(self, t, z):
        return (z.a + z.b + z.c - 1.0,)

    def outputs(self, t, z):
        return {"a": z.a, "b": z.b, "c": z.c}

    def initial(self):
        return {"a": 1.0}


def test_robertsons_reactions_agree_with_their_differential_equations():
    grid = al.Grid(40.0, 8)
    found = al.simulate(Robertson(), grid, integrator=al.integrators.Kvaerno5(rtol=1e-10, atol=1e-14))

    def rates(t, y):
        a, b, c = y
        return [-0.04 * a + 1e4 * b * c, 0.04 * a - 1e4 * b * c - 3e7 * b**2, 3e7 * b**2]

    exact = solve_ivp(
        rates, (0.0, 40.0), [1.0, 0.0, 0.0], method="Radau", rtol=1e-11, atol=1e-15, t_eval=np.asarray(grid.times)
    )
    for name, column in zip("abc", exact.y, strict=True):
        np.testing.assert_allclose(found[name], column, rtol=1e-8, atol=1e-12)


class Bent(al.System):
    """Two algebraic variables, one of them an array, and a state that both of them move; `push` is read by no rate."""

    states = ("x",)
    algebraic = ("y", "pair")

    stiffness: Any = 1.0

    def rhs(self, t, z):
        return (-z.y - 0.1 * z.pair[0] * z.pair[1],)

    def residual(self, t, z, push):
        first, second = z.pair
        return z.y + self.stiffness * z.y**3 - z.x - push, jnp.stack([2.0 * first - z.y - 0.2 * second, second - first])

    def algebraic_guess(self, t, z):
        return {"pair": jnp.ones(2)}

    def outputs(self, t, z, push):
        return {"x": z.x, "y": z.y, "pair": z.pair}

    def initial(self):
        return {"x": 1.0}


PUSH = {"push": al.PowerSeries(start=(0.0, 1.0), end=(0.5, -1.0))}


def by_hand(stiffness: float = 1.0, t_final: float = 2.0) -> tuple[float, float]:
    """The last state and `y`: Newton's method and integrator are SciPy's."""
    curve = next(iter(PUSH.values())).over(0.0, t_final)

    def y_of(t, x):
        push = float(curve(jnp.asarray(t)))
        return brentq(lambda y: y + stiffness * y**3 - x - push, -10.0, 10.0, xtol=1e-15, rtol=1e-15)

    def rates(t, state):
        y = y_of(t, state[0])
        return [-y - 0.1 * (y / 1.8) ** 2]

    x = solve_ivp(rates, (0.0, t_final), [1.0], method="DOP853", rtol=1e-12, atol=1e-13).y[0, -1]
    return x, y_of(t_final, x)


@pytest.mark.slow
def test_each_integrator_keeps_its_order():
    exact = np.array(by_hand())
    errors = []
    for steps in (8, 16, 32):
        found = al.simulate(Bent(), al.Grid(2.0, steps), PUSH)
        np.testing.assert_allclose(found["pair"][-1], found["y"][-1] / 1.8, rtol=1e-12)
        errors.append(np.abs([found["x"][-1], found["y"][-1]] - exact))
    np.testing.assert_allclose(np.log2(errors[-2] / errors[-1]), 4.0, atol=0.3)
    adaptive = al.simulate(Bent(), al.Grid(2.0, 4), PUSH, al.integrators.Tsit5(rtol=1e-10, atol=1e-12))
    np.testing.assert_allclose([adaptive["x"][-1], adaptive["y"][-1]], exact, rtol=1e-9)


@pytest.mark.slow
def test_derivatives_of_any_order_agree_with_differences_and_a_closed_form():
    grid, inputs = al.Grid(2.0, 40), {"feed": al.PowerSeries(start=0.5, end=1.5)}

    def ends(constant: Any, tank: Any) -> Any:
        return al.simulate(tank(constant=constant), grid, inputs)["hydrogen"][-1]

    def all_orders(tank: Any) -> Any:
        def of(constant: Any) -> Any:
            first = jax.jacfwd(lambda at: ends(at, tank))
            return ends(constant, tank), first(constant), jax.jacfwd(first)(constant), jax.grad(ends)(constant, tank)

        return compiled(of)

    value, slope, curvature, backward = all_orders(Tank)(0.1)
    np.testing.assert_allclose([value, slope, curvature], all_orders(ExplicitTank)(0.1)[:3], rtol=1e-10)
    assert backward == pytest.approx(float(slope), rel=1e-10)
    up, down = (float(ends(constant, Tank)) for constant in (0.1 + 1e-5, 0.1 - 1e-5))
    assert slope == pytest.approx((up - down) / 2e-5, rel=1e-7)


def test_a_system_without_states_solves_its_equations_at_each_instant():
    class Valve(al.System):
        states = ()
        algebraic = ("flow",)

        def rhs(self, t, z):
            return ()

        def residual(self, t, z, pressure):
            return (z.flow + z.flow**3 - pressure,)

        def outputs(self, t, z):
            return {"flow": z.flow}

    grid = al.Grid(1.0, 5)
    flow = np.asarray(al.simulate(Valve(), grid, {"pressure": al.PowerSeries(start=0.0, end=2.0)})["flow"])
    np.testing.assert_allclose(flow + flow**3, 2.0 * np.asarray(grid.times), atol=1e-14)


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
    for near in (1.0, -0.3):
        found = al.simulate(Folded(near=near), al.Grid(0.9, 3))["y"]
        np.testing.assert_allclose(found, np.sign(near) * np.sqrt([1.0, 0.7, 0.4, 0.1]), rtol=1e-12)


class Rootless(al.System):
    """Has no real root below the axis, for any push."""

    states = ("x",)
    algebraic = ("y",)

    def initial(self):
        return {"x": 1.0}

    def rhs(self, t, z, push):
        return (-z.y + push,)

    def residual(self, t, z, push):
        return (z.y**2 + z.x + push,)

    def outputs(self, t, z, push):
        return {"x": z.x}


def test_what_has_no_solution_is_told_where_inputs_are_trajectories():
    told = simulation_of(Rootless(), al.Grid(2.0, 4), {"push": al.BSpline(np.full(4, 0.1))}, None).explain()
    assert re.match("Rootless: its algebraic variables have no solution at about t = 0", told)


@pytest.mark.slow
@pytest.mark.parametrize("integrator", [None, al.integrators.Tsit5()], ids=["RungeKutta4", "Tsit5"])
def test_where_solutions_meet_is_told(integrator):
    told = simulation_of(Folded(), al.Grid(2.0, 8), None, integrator).explain()
    assert re.match(r"Folded: its algebraic variables have no solution at about t = 1(\.0\d*)? s", told)
    assert "algebraic_guess" in told or "the Jacobian is singular there" in told


def test_nothing_is_told_of_a_system_that_can_be_solved():
    assert not simulation_of(Folded(), al.Grid(0.9, 3), None, None).explain()


@pytest.mark.slow
def test_an_index_above_one_is_told_with_realisation_and_time():
    problem = al.Problem(
        IndexTwo(near=al.Uniform(1.0, half_width=al.Decision(0.1, 0.05, 0.2))),
        grid=al.Grid(2.0, 8),
        minimize=al.rms("y").mean,
    )
    segments = al.Simultaneous(al.schemes.MultipleShooting(2))
    for transcription in (al.Sequential(), al.Simultaneous(), segments):
        with pytest.raises(
            al.SimulationError, match=r"t = 0 s, .* near=0\.9.*singular.*index 1.*collocation point 1 of 12"
        ):
            al.solve(problem, transcription=transcription)


def test_newton_that_does_not_converge_tells_its_residuals():
    class Nowhere(Folded):
        algebraic = ("y", "w")

        def residual(self, t, z):
            return z.y**2 + 1.0, z.w - z.y

    told = simulation_of(Nowhere(), al.Grid(2.0, 8), None, None).explain()
    assert "equation 1 of 2 is left with a residual of" in told
    assert "(all:" in told


class Unequal(Folded):
    def residual(self, t, z):
        return z.y**2 - z.x, z.y


class Unlisted(Folded):
    def residual(self, t, z):
        return z.y**2 - z.x


class Nameless(Folded):
    algebraic = ()


class Wordless(al.System):
    states = ("x",)
    algebraic = ("y",)

    def rhs(self, t, z):
        return (-z.x,)

    def outputs(self, t, z):
        return {"x": z.x}


class Doubled(Folded):
    algebraic = ("x",)


class Unbracketed(Folded):
    algebraic: Any = "y"


class Misguessed(Folded):
    def algebraic_guess(self, t, z):
        return {"q": 1.0}


class Begun(Folded):
    def initial(self):
        return {"x": 1.0, "y": 1.0}


class Asking(Folded):
    def residual(self, t, z, wind):
        return (z.y - wind,)


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (Unequal, r"Unequal\.residual: expected as many equations as .* \('y',\), 1; received 2"),
        (Unlisted, r"Unlisted\.residual returns the equations as a tuple"),
        (Nameless, r"writes residual and algebraic_guess, but names no algebraic variables: expected `algebraic = "),
        (Wordless, r"names the algebraic variables \('y',\), but no equations for them: write residual\(self, t, z\)"),
        (Doubled, r"distinct Python names.*\('x', 'x'\)"),
        (Unbracketed, r"as a tuple.*received 'y'"),
        (Misguessed, r"Misguessed\.algebraic_guess returns a dict .* \('y',\); received {'q': 1\.0}"),
        (
            Begun,
            r"Begun\.initial names \['y'\], which follow from the states: give .* in algebraic_guess",
        ),
        (Asking, r"takes the inputs \['wind'\]; received \[\]"),
    ],
)
def test_what_does_not_fit_together_is_refused_in_words(system, message):
    with pytest.raises(al.ProblemError, match=message):
        al.simulate(system(), al.Grid(1.0, 2))
