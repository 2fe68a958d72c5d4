"""Differential equations and formulas of SymPy as systems: values, programs that are shared, a design, refusals."""

import jax
import numpy as np
import pytest
import sympy as sp
from sympy.physics.mechanics import dynamicsymbols

import aleator as al
from aleator.dynamics._simulate import _HISTORY
from aleator.foreign._sympy_expressions import written
from compiling import compiled
from zoo import Oscillator

X, V, FORCE = dynamicsymbols("x v force")
M, C, K, X_0 = sp.symbols("m c k x_0")
T = dynamicsymbols._t
RATES = {X: V, V: (FORCE - C * V - K * X) / M}
NUMBERS = {M: 2.0, C: 1.5, K: 40.0}
PUSH = {"force": al.Tabulated([0.0, 1.0], [0.0, 3.0])}


def oscillator(numbers=NUMBERS, **more):
    return al.foreign.from_sympy(RATES, numbers, **more)


def test_a_system_of_sympy_moves_as_the_same_one_written_by_hand():
    outputs = {"x": X, "v": V, "spring": K * X, "acceleration": X.diff(T, 2), "force": M * V.diff(T)}
    found = al.simulate(oscillator(NUMBERS | {X_0: 0.3}, outputs=outputs, start={X: X_0}), al.Grid(1.0, 50), PUSH)
    ours = al.simulate(Oscillator(m=2.0, c=1.5, k=40.0, x0=0.3), al.Grid(1.0, 50), PUSH)
    for name in ("x", "v", "spring"):
        np.testing.assert_allclose(found[name], ours[name], rtol=0, atol=1e-13, err_msg=name)
    push = np.linspace(0.0, 3.0, 51)
    x, v, acceleration = map(np.asarray, (ours["x"], ours["v"], found["acceleration"]))
    np.testing.assert_allclose(found["force"], push - 1.5 * v - 40 * x, atol=1e-12)
    np.testing.assert_allclose(found["force"], 2 * acceleration, rtol=1e-15)


def test_plain_symbols_may_be_states_and_the_time_may_stand_in_rates():
    x, a = sp.symbols("x a")
    found = al.simulate(al.foreign.from_sympy({x: -a * x + a * sp.sin(T)}, {a: 3.0}, start={x: 1.0}), al.Grid(2.0, 400))
    t = np.linspace(0.0, 2.0, 401)
    closed = 1.3 * np.exp(-3 * t) + (9 * np.sin(t) - 3 * np.cos(t)) / 10
    np.testing.assert_allclose(found["x"], closed, rtol=0, atol=1e-9)


def test_equal_models_share_a_program_and_others_never_do():
    grid = al.Grid(1.0, 17)
    first = al.simulate(oscillator(start={X: 0.3}), grid, PUSH)["x"]
    count = _HISTORY.compilations
    # The same equations, made again, with other numbers and the same symbols of another order.
    again = al.foreign.from_sympy(dict(RATES), {K: 50.0, C: 1.5, M: 2.0}, start={X: 0.3})
    second = al.simulate(again, grid, PUSH)["x"]
    assert _HISTORY.compilations == count
    # The same names and numbers, but another equation.
    other = al.foreign.from_sympy(RATES | {V: (FORCE - C * V - K * X**3) / M}, NUMBERS, start={X: 0.3})
    third = al.simulate(other, grid, PUSH)["x"]
    assert _HISTORY.compilations == count + 1
    assert min(np.abs(first - second).max(), np.abs(first - third).max(), np.abs(second - third).max()) > 0.01


FUNCTIONS = {
    "powers": X_0**3 + 1 / X_0 + sp.sqrt(X_0) / X_0**2 + (1 / X_0) ** C + X_0 ** sp.Rational(-3, 2),
    "trigonometry": sp.sin(X_0) * sp.tan(X_0) + sp.atan2(X_0, C) + sp.asin(X_0 / 9) + sp.sec(X_0) + sp.cot(X_0),
    "exponentials": sp.exp(-X_0) + sp.log(X_0) + sp.tanh(X_0) + sp.acosh(3 + X_0) + sp.sinh(X_0),
    "kinks": sp.Abs(X_0 - 3) + sp.Max(X_0, C, 0) + sp.Min(X_0, C) + sp.sign(X_0) + sp.Heaviside(X_0 - C),
    "pieces": sp.Piecewise((X_0**2, (X_0 > 1) & (X_0 < 2)), (sp.cos(X_0), X_0 > 3), (0, True)),
    "special": sp.erf(X_0)
    + sp.erfc(X_0)
    + sp.gamma(X_0)
    + sp.loggamma(X_0)
    + sp.sinc(X_0)
    + sp.Mod(X_0, C)
    + sp.floor(X_0),
    "constants": sp.pi * X_0 + sp.E**2 + sp.Rational(1, 3) + sp.Float("0.1") * X_0 + sp.GoldenRatio,
    "for real numbers": sp.re(X_0) + sp.conjugate(X_0) + sp.Abs(X_0**2 - C).diff(X_0),
}


NUMBERS_KEPT = [1 / 3, -2e20 / 3, 1e-300 / 7, 10**30, sp.Rational(10**40, 7), sp.Float("0.1", 50)]


def test_functions_have_the_values_that_sympy_gives_them_and_numbers_are_kept_to_their_last_bit():
    functions = [*FUNCTIONS.values(), *(number * X_0 for number in NUMBERS_KEPT)]
    program = written("test", functions, [X_0, C])
    values = np.array([0.7, 1.4, 3.5, 1.0])
    *found, one_third, large, small, power, fraction, tenth = compiled(jax.vmap(lambda x: program([x, 1.3])))(values)
    real = sp.Symbol("r", real=True)
    for kind, value in zip(FUNCTIONS, found, strict=True):
        formula = FUNCTIONS[kind].xreplace({X_0: real}).doit()
        expected = [float(formula.subs({real: x, C: 1.3}).evalf(20)) for x in values[:3]]
        np.testing.assert_allclose(value[:3], expected, rtol=1e-13, err_msg=kind)
    for number, value in zip(NUMBERS_KEPT, (one_third, large, small, power, fraction, tenth), strict=True):
        assert float(value[3]) == float(number)


def test_formulas_are_a_system_without_time_whose_statistics_are_exact():
    force, length, modulus = sp.symbols("F L E", positive=True)
    beam = al.foreign.from_sympy_formulas(
        {"sag": force * length**3 / (3 * modulus), "moment": force * length},
        {force: al.Uniform(10.0, half_width=0.5), length: al.Decision(2.0, 1.0, 3.0), modulus: 4.0},
        units={"moment": "N m"},
    )
    sag, moment = al.output("sag"), al.output("moment")
    solution = al.solve(
        al.Problem(beam, minimize=sag.mean + sag.std, subject_to=[moment.mean >= 15.0], expansion=al.Expansion(order=1))
    )
    assert solution.decisions["L"] == pytest.approx(1.5, rel=1e-6)
    assert solution.objective == pytest.approx(1.5**3 / 12 * (10 + 0.5 / np.sqrt(3)), rel=1e-6)
