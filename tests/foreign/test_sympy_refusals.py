"""What is wrong with a model of SymPy is said in one sentence, before anything is compiled."""

import pytest
import sympy as sp
from sympy.physics import mechanics as me

import aleator as al

X, V, FORCE = me.dynamicsymbols("x v force")
M, C, K = sp.symbols("m c k")
P = sp.symbols("p", positive=True)
T = me.dynamicsymbols._t
RATES = {X: V, V: (FORCE - C * V - K * X) / M}
lagrange, sympy, formulas = al.foreign.from_lagrange, al.foreign.from_sympy, al.foreign.from_sympy_formulas


def formed(lagrangian, coordinates, **more):
    method = me.LagrangesMethod(lagrangian, coordinates, **more)
    method.form_lagranges_equations()
    return method


REFUSED = {
    "a number is missing": (lambda: sympy(RATES, {M: 2.0, C: 1.5}), "received none for ['k']"),
    "a symbol has other assumptions": (
        lambda: sympy(RATES, {M: 1.0, C: 1.0, sp.Symbol("k", positive=True): 1.0}),
        "another symbol than the model's",
    ),
    "two symbols have one name": (
        lambda: sympy({X: -P * X * sp.Symbol("p")}, {P: 1.0, sp.Symbol("p"): 1.0}),
        "two different symbols are called 'p'",
    ),
    "a function is none of JAX": (lambda: sympy({X: -sp.besselj(0, sp.sin(X))}, {}), "no function for besselj"),
    "an integral is not done": (
        lambda: formulas({"y": sp.Integral(K**C, (K, 0, M))}, {C: 1.0, M: 1.0}),
        "no function for Integral; rewrite it by elementary ones",
    ),
    "constraints are nonholonomic": (
        lambda: lagrange(formed(X.diff() ** 2 + V.diff() ** 2, [X, V], nonhol_coneqs=[X.diff() - V * V.diff()]), {}),
        "received nonholonomic ones",
    ),
    "a motion is prescribed": (
        lambda: lagrange(formed(M * (X.diff() + V.diff()) ** 2, [X]), {M: 1.0}),
        "received Derivative(v(t), (t, 2)). Make a motion that is prescribed a coordinate",
    ),
    "a start changes with time": (lambda: sympy({X: -X, V: X}, {}, start={V: T}), "start: expected no other symbols"),
}


CONTRADICTED = [
    ({"integer": True}, 2.5, "integer"),
    ({"nonzero": True}, al.Uniform.bounds(-1.0, 1.0), "nonzero"),
    ({"nonnegative": True}, al.Normal(1.0, 0.1), "nonnegative"),
]


@pytest.mark.parametrize(("assumptions", "number", "kind"), CONTRADICTED)
def test_a_number_that_contradicts_an_assumption_of_its_symbol_is_refused(assumptions, number, kind):
    n = sp.Symbol("n", **assumptions)
    with pytest.raises(al.ProblemError, match=f"SymPy takes 'n' to be {kind}, and simplifies by it; received"):
        formulas({"y": n * M}, {n: number, M: 1.0})


@pytest.mark.parametrize("what", REFUSED)
def test_a_model_is_refused_in_one_sentence_if(what):
    call, words = REFUSED[what]
    with pytest.raises(al.ProblemError) as caught:
        call()
    assert words in str(caught.value)
    assert len(str(caught.value)) <= 400
