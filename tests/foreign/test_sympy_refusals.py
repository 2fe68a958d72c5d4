"""What is wrong with a model of SymPy is said in one sentence, before anything is compiled."""

import pytest
import sympy as sp
from sympy.physics import mechanics as me

import aleator as al

X, V, FORCE = me.dynamicsymbols("x v force")
M, C, K, X_0 = sp.symbols("m c k x_0")
P = sp.symbols("p", positive=True)
I = sp.Symbol("i", integer=True)  # noqa: E741
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
    "a symbol has other assumptions": (
        lambda: sympy(RATES, {M: 1.0, C: 1.0, sp.Symbol("k", positive=True): 1.0}),
        "another symbol than the model's",
    ),
    "a number contradicts its symbol": (
        lambda: sympy({X: -P * X}, {P: al.Normal(1.0, 0.1)}),
        "SymPy takes 'p' to be positive, and simplifies by it; received Normal",
    ),
    "a state is integer": (
        lambda: sympy({I: -I}, {}, start={I: 1.0}),
        "SymPy takes 'i' to be integer, and simplifies by it; expected a symbol without this assumption",
    ),
    "two symbols have one name": (
        lambda: sympy({X: -P * X * sp.Symbol("p")}, {P: 1.0, sp.Symbol("p"): 1.0}),
        "two different symbols are called 'p'",
    ),
    "an equation is implicit": (lambda: sympy({X: sp.Eq(V, 1)}, {}), "received an equation. Solve it"),
    "a number is a signal": (
        lambda: sympy({X: -K * X}, {K: al.PowerSeries(start=(1.0,))}),
        "takes the symbol 'k' to be constant",
    ),
    "an input is a number": (lambda: sympy(RATES, NUMBERS | {FORCE: 1.0}), "force(t) is an input, not one of numbers"),
    "a function is none of JAX": (lambda: sympy({X: -sp.besselj(0, sp.sin(X))}, {}), "no function for besselj"),
    "an expression is complex": (
        lambda: sympy({X: sp.I * X}, {}),
        "real and finite expressions; received I*x",
    ),
    "a mass matrix has another size": (
        lambda: sympy({X: V, V: -X}, {}, mass_matrix=sp.eye(3)),
        "a SymPy matrix of shape (2, 2)",
    ),
    "a start contains a state": (lambda: sympy(RATES, NUMBERS, start={X: V}), "expressions of the parameters alone"),
    "a formula has time": (lambda: formulas({"a": X}, {}), "expected formulas without time; received x(t)"),
    "Kane's equations are not formed": (
        lambda: kane(me.KanesMethod(me.ReferenceFrame("N"), [X], [V], kd_eqs=[X.diff() - V]), {}),
        "call kanes_equations() first",
    ),
    "constraints are nonholonomic": (
        lambda: lagrange(formed(X.diff() ** 2 + V.diff() ** 2, [X, V], nonhol_coneqs=[X.diff() - V * V.diff()]), {}),
        "received nonholonomic ones",
    ),
    "equations of motion contain the time": (
        lambda: lagrange(formed(X.diff() ** 2 * M + T * X, [X]), {M: 1.0}),
        "the time t stands in the model",
    ),
}


CONTRADICTED = [
    ({"integer": True}, 2.5, "integer"),
    ({"integer": True}, al.Uniform.bounds(0.2, 0.8), "integer"),
    ({"prime": True}, 9, "prime"),
    ({"nonzero": True}, al.Uniform.bounds(-1.0, 1.0), "nonzero"),
    ({"nonnegative": True}, al.Normal(1.0, 0.1), "nonnegative"),
]
KEPT = [
    ({"integer": True}, -2.0),
    ({"prime": True}, 7),
    ({"nonzero": True}, al.Uniform.bounds(1.0, 2.0)),
    ({"noninteger": True}, al.Uniform.bounds(1.2, 1.8)),
    ({"nonnegative": True}, al.Uniform.bounds(0.0, 1.0)),
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
        (sp.CRootOf(C**5 + C + 1, 0) * K, "ComplexRootOf"),
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
