"""What is wrong with a model of SymPy is said in one sentence, before anything is compiled."""

import numpy as np
import pytest
import sympy as sp
from sympy.physics import mechanics as me
from sympy_models import OMEGA, ROD, THETA, WORLD, D, G, L, M, rod_by_kane, rod_by_lagrange

import aleator as al

X, V, FORCE = me.dynamicsymbols("x v force")
C, K, X_0 = sp.symbols("c k x_0")
P = sp.symbols("p", positive=True)
I, EVEN = sp.Symbol("i", integer=True), me.dynamicsymbols("turns", even=True)  # noqa: E741
T = me.dynamicsymbols._t
RATES, NUMBERS = {X: V, V: (FORCE - C * V - K * X) / M}, {M: 2.0, C: 1.5, K: 40.0}
GRID = al.Grid(1.0, 5)
kane, lagrange, sympy = al.foreign.from_kane, al.foreign.from_lagrange, al.foreign.from_sympy
formulas = al.foreign.from_sympy_formulas


def formed(lagrangian, coordinates, **more):
    method = me.LagrangesMethod(lagrangian, coordinates, **more)
    method.form_lagranges_equations()
    return method


REFUSED = {
    "a number is missing": (lambda: sympy(RATES, {M: 2.0, C: 1.5}), "received none for ['k']"),
    "a number is not used": (lambda: sympy(RATES, NUMBERS | {X_0: 1.0}), "numbers has 'x_0', which is no parameter"),
    "a symbol is misspelt": (lambda: sympy(RATES, NUMBERS | {sp.Symbol("kk"): 1.0}), "Did you mean 'k'?"),
    "a symbol has other assumptions": (
        lambda: sympy(RATES, {M: 1.0, C: 1.0, sp.Symbol("k", positive=True): 1.0}),
        "another symbol than the model's",
    ),
    "a number contradicts its symbol": (
        lambda: sympy({X: -P * X}, {P: al.Normal(1.0, 0.1)}),
        "SymPy takes 'p' to be positive, and simplifies by it; received Normal",
    ),
    "a start has other assumptions": (
        lambda: sympy({X: -X}, {}, start={sp.Symbol("x"): 1.0}),
        "'x' is another symbol than the model's of this name: one is a function of time, or their assumptions differ",
    ),
    "a start contradicts its symbol": (
        lambda: sympy({P: -P}, {}, start={P: -1.0}),
        "start: SymPy takes 'p' to be positive, and simplifies by it; received -1.0",
    ),
    "a state is integer": (
        lambda: sympy({I: -I}, {}, start={I: 1.0}),
        "SymPy takes 'i' to be integer, and simplifies by it; expected a symbol without this assumption",
    ),
    "a coordinate is even": (
        lambda: lagrange(formed(EVEN.diff() ** 2 - EVEN**2, [EVEN]), {}),
        "takes 'turns' to be integer",
    ),
    "two symbols have one name": (
        lambda: sympy({X: -P * X * sp.Symbol("p")}, {P: 1.0, sp.Symbol("p"): 1.0}),
        "two different symbols are called 'p'",
    ),
    "a symbol is called like a speed": (
        lambda: lagrange(rod_by_lagrange(), ROD | {X_0: 1.0}, outputs={"a": sp.Symbol("theta_rate")}),
        "two different symbols are called 'theta_rate'",
    ),
    "an equation is implicit": (lambda: sympy({X: sp.Eq(V, 1)}, {}), "received an equation. Solve it"),
    "a rate contains a rate": (lambda: sympy({X: V, V: X.diff()}, {}), "received Derivative(x(t), t). Solve"),
    "a number is an array": (lambda: sympy({X: -K * X}, {K: np.ones(2)}), "one number for 'k'; received shape (2,)"),
    "a number is a signal": (
        lambda: sympy({X: -K * X}, {K: al.PowerSeries(start=(1.0,))}),
        "takes the symbol 'k' to be constant",
    ),
    "an input is a number": (lambda: sympy(RATES, NUMBERS | {FORCE: 1.0}), "force(t) is an input, not one of numbers"),
    "a constant of SymPy changes": (
        lambda: kane(rod_by_kane(), ROD | {M: al.PowerSeries(start=(1.0,))}),
        "takes the symbol 'm' to be constant; received a signal, PowerSeries",
    ),
    "a function is none of JAX": (lambda: sympy({X: -sp.besselj(0, sp.sin(X))}, {}), "no function for besselj"),
    "an expression is complex": (
        lambda: sympy({X: sp.I * X}, {}),
        "real and finite expressions; received I*x",
    ),
    "an expression is infinite": (lambda: sympy({X: sp.zoo}, {}), "received zoo"),
    "a function is not of time": (lambda: sympy({X: sp.Function("f")(X)}, {}), "received f(x(t))"),
    "nothing moves": (lambda: sympy({}, {}), "the rate of one state at least"),
    "a state is no name": (lambda: sympy({sp.Symbol("\\theta"): 1}, {}), "must be valid identifiers"),
    "a mass matrix has another size": (
        lambda: sympy({X: V, V: -X}, {}, mass_matrix=sp.eye(3)),
        "a SymPy matrix of shape (2, 2)",
    ),
    "an output is a matrix": (
        lambda: sympy(RATES, NUMBERS, outputs={"a": sp.Matrix([X])}),
        "'a': expected one",
    ),
    "an output differentiates an input": (
        lambda: sympy(RATES, NUMBERS, outputs={"a": FORCE.diff()}),
        "received Derivative(force(t), t)",
    ),
    "a start contains a state": (lambda: sympy(RATES, NUMBERS, start={X: V}), "expressions of the parameters alone"),
    "an input is not given": (
        lambda: al.simulate(sympy(RATES, NUMBERS), GRID),
        "['force']; received []",
    ),
    "an input is not known": (
        lambda: al.simulate(sympy({X: -X}, {}), GRID, {"force": al.Tabulated([0.0, 1.0], [0.0, 1.0])}),
        "takes the inputs []; received ['force']",
    ),
    "a formula has time": (lambda: formulas({"a": X}, {}), "expected formulas without time; received x(t)"),
    "Kane's equations are not formed": (
        lambda: kane(me.KanesMethod(WORLD, [THETA], [OMEGA], kd_eqs=[THETA.diff() - OMEGA]), {}),
        "call kanes_equations() first",
    ),
    "Lagrange's equations are not formed": (
        lambda: lagrange(me.LagrangesMethod(THETA.diff() ** 2, [THETA]), {}),
        "call form_lagranges_equations() first",
    ),
    "constraints are nonholonomic": (
        lambda: lagrange(formed(X.diff() ** 2 + V.diff() ** 2, [X, V], nonhol_coneqs=[X.diff() - V * V.diff()]), {}),
        "received nonholonomic ones",
    ),
    "equations of motion contain the time": (
        lambda: lagrange(formed(X.diff() ** 2 * M + T * X, [X]), {M: 1.0}),
        "the time t stands in the model",
    ),
    "a support is driven": (
        lambda: lagrange(formed((X.diff() + V.diff()) ** 2 * M, [X]), {M: 1.0}),
        "Make v(t) a coordinate, and prescribe its motion by al.HybridDynamics",
    ),
    "an output is misspelt": (
        lambda: kane(rod_by_kane(), ROD, outputs={"a": me.dynamicsymbols("thetta")}),
        "do not contain thetta(t). Did you mean 'theta(t)'?",
    ),
    "an output has a standard name": (
        lambda: al.simulate(al.ForwardDynamics(kane(rod_by_kane(), ROD, outputs={"theta": THETA})), GRID),
        "['theta'] are standard outputs",
    ),
}


CONTRADICTED = [
    ({"integer": True}, 2.5, "integer"),
    ({"integer": True}, al.Uniform.bounds(0.2, 0.8), "integer"),
    ({"integer": True}, al.Decision(2.0, 1.0, 3.0), "integer"),
    ({"odd": True}, 4.0, "odd"),
    ({"prime": True}, 9, "prime"),
    ({"composite": True}, 7, "composite"),
    ({"noninteger": True}, al.Normal(0.5, 0.1), "noninteger"),
    ({"integer": False}, 2.0, "not integer"),
    ({"positive": True, "integer": True}, 2.5, "integer"),
    ({"nonzero": True}, al.Uniform.bounds(-1.0, 1.0), "nonzero"),
    ({"zero": False}, 0.0, "not zero"),
    ({"positive": False}, 1.0, "not positive"),
    ({"nonnegative": True}, al.Normal(1.0, 0.1), "nonnegative"),
    ({"nonpositive": True}, al.Uniform.bounds(-1.0, 1.0), "nonpositive"),
    ({"negative": True}, 0.0, "negative"),
    ({"imaginary": True}, 1.0, "imaginary"),
    ({"infinite": True}, 1.0, "infinite"),
]
KEPT = [
    ({"integer": True}, -2.0),
    ({"odd": True}, np.int64(3)),
    ({"prime": True}, 7),
    ({"composite": True}, 9),
    ({"nonzero": True}, al.Uniform.bounds(1.0, 2.0)),
    ({"noninteger": True}, al.Uniform.bounds(1.2, 1.8)),
    ({"nonnegative": True}, al.Uniform.bounds(0.0, 1.0)),
    ({"nonpositive": True}, 0.0),
    ({"real": True}, al.Normal(0.0, 1.0)),
    ({"finite": True, "rational": True}, 0.1),
]


@pytest.mark.parametrize(("assumptions", "number", "kind"), CONTRADICTED)
def test_a_number_that_contradicts_an_assumption_of_its_symbol_is_refused(assumptions, number, kind):
    n = sp.Symbol("n", **assumptions)
    with pytest.raises(al.ProblemError, match=f"SymPy takes 'n' to be {kind}, and simplifies by it; received"):
        formulas({"y": n * M}, {n: number, M: 1.0})


@pytest.mark.parametrize(("assumptions", "number"), KEPT)
def test_a_number_that_agrees_with_the_assumptions_of_its_symbol_is_taken(assumptions, number):
    n = sp.Symbol("n", **assumptions)
    assert set(formulas({"y": n * M + 1}, {n: number, M: 1.0}).numbers) == {"m", "n"}


@pytest.mark.parametrize(
    ("expression", "said"),
    [
        (sp.Sum((K - I) ** 2, (I, 1, 3)), "Sum"),
        (sp.Product(K - I, (I, 1, 3)), "Product"),
        (sp.Subs(sp.sin(K) * C, K, C), "Subs"),
        (sp.Integral(sp.sin(K * C) / C, (C, 0, 1)), "Integral"),
        (sp.CRootOf(C**5 + C + 1, 0) * K, "ComplexRootOf"),
        (sp.factorial(K), "factorial"),
    ],
)
def test_what_the_printer_of_sympy_cannot_write_for_jax_is_refused_by_name(expression, said):
    numbers = dict.fromkeys(expression.free_symbols, 1.0)
    with pytest.raises(al.ProblemError, match=rf"no function for {said}; rewrite it .*\.doit\(\)"):
        formulas({"y": expression}, numbers)


@pytest.mark.parametrize("what", REFUSED)
def test_a_model_is_refused_in_one_sentence_if(what):
    call, words = REFUSED[what]
    with pytest.raises(al.ProblemError) as caught:
        call()
    assert words in str(caught.value)
    assert len(str(caught.value)) <= 400


def test_rates_of_coordinates_with_further_terms_are_refused():
    method = me.KanesMethod(WORLD, [THETA], [OMEGA], kd_eqs=[THETA.diff() - OMEGA - G])
    pin, frame = me.Point("O"), WORLD.orientnew("A", "Axis", [THETA, WORLD.z])
    pin.set_vel(WORLD, 0)
    frame.set_ang_vel(WORLD, OMEGA * WORLD.z)
    end = pin.locatenew("P", L * frame.x)
    end.v2pt_theory(pin, WORLD, frame)
    method.kanes_equations([me.Particle("ball", end, M)], [(end, -M * D * WORLD.y)])
    with pytest.raises(al.ProblemError, match="linear in the speeds, without further terms"):
        kane(method, {M: 1.0, L: 1.0, D: 1.0, G: 9.81})
