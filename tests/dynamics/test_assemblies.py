"""Assemblies of parts by vector loops: clutch, four-bar linkage and plates against closed forms; formulas; refusals."""

import itertools
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.dynamics import explain_failure, solve_algebraic
from aleator.uncertainty import placements, realise
from compiling import compiled

# The one-way clutch of the dissertation, 7.2: hub, roller and ring; lengths in mm.
NOMINAL = np.array([27.645, 11.430, 50.800])
TOLERANCES = np.array([0.05, 0.01, 0.0125])
CLUTCH_LOOP = [("a", 90), ("b", 0), ("c", 90), ("c", "90 - chi"), ("-e", "90 - chi")]


def clutch(a, c, e, chi=7.0):
    return al.Assembly(
        dimensions={"a": a, "c": c, "e": e},
        unknowns={"b": 4.8, "chi": chi},
        loops=[CLUTCH_LOOP],
        units={"chi": "deg", "b": "mm"},
    )


def clutch_in_closed_form(a, c, e):
    """The offset `b` and the pressure angle in degrees."""
    return np.stack([np.sqrt((e - c) ** 2 - (a + c) ** 2), np.rad2deg(np.arccos((a + c) / (e - c)))])


def dependent(dimensions):
    solved = solve_algebraic(clutch(*dimensions))
    return jnp.stack([solved.unknowns.b, solved.unknowns.chi]), solved.converged


@cache
def clutches():
    """Twelve times the tolerances and a sweep of the hub's height: χ from 2° to 15°, with a guess of 7° for all."""
    random = np.random.default_rng(11)
    dimensions = NOMINAL + 12 * TOLERANCES * random.uniform(-1, 1, (1000, 3))
    sweep = np.stack([np.linspace(26.6, 27.9, 400), np.full(400, 11.43), np.full(400, 50.8)], axis=1)
    dimensions = np.concatenate([dimensions, sweep])
    dimensions = dimensions[(dimensions[:, 0] + 2 * dimensions[:, 1]) < dimensions[:, 2] - 0.02]
    points, weights = np.polynomial.hermite_e.hermegauss(7)
    germ = np.array(list(itertools.product(points, repeat=3)))
    weight = np.prod(list(itertools.product(weights / weights.sum(), repeat=3)), axis=1)
    found, converged = compiled(jax.vmap(dependent))(np.concatenate([dimensions, NOMINAL + germ * TOLERANCES / 3]))
    assert np.asarray(converged).all()
    return dimensions, np.asarray(found), weight


def outputs_of(assembly):
    """Each output at the one instant."""
    return {name: np.asarray(value)[0] for name, value in al.simulate(assembly).items()}


def test_clutches_within_many_tolerances_are_those_of_the_closed_form():
    dimensions, found, _ = clutches()
    exact = clutch_in_closed_form(*dimensions.T).T
    assert exact[:, 1].min() < 3 < 13 < exact[:, 1].max()
    np.testing.assert_allclose(found[: len(exact)], exact, rtol=1e-12)


def test_the_spread_of_the_clutch_is_the_published_exact_value():
    # Gauss-Hermite quadrature over the three dimensions, 7 points each; studies.md: 3σ of χ is 0.6590101°.
    _, found, weight = clutches()
    angles = found[-len(weight) :, 1]
    mean = weight @ angles
    assert 3 * np.sqrt(weight @ (angles - mean) ** 2) == pytest.approx(0.6590101, abs=5e-8)
    assert placements(clutch(*map(al.Normal, NOMINAL, TOLERANCES / 3))).germ_names == ("a", "c", "e")


LENGTHS = {"ground": 100, "crank": 30, "coupler": 80, "rocker": 70, "theta": 60}
"""Of a four-bar linkage, and the crank's angle in degrees."""


def four_bar_in_closed_form():
    """Angles of coupler and rocker in degrees and the joint between, by the two circles around the moving ends."""
    pin = 30 * np.exp(1j * np.deg2rad(60.0))
    across = 100 - pin
    distance = abs(across)
    at_pin = np.arccos((80**2 + distance**2 - 70**2) / (2 * 80 * distance))
    joint = pin + 80 * np.exp(1j * (np.angle(across) + at_pin))
    return np.rad2deg(np.angle([joint - pin, joint - 100])), joint


def test_a_four_bar_linkage_and_its_features_are_those_of_the_closed_form():
    features = {
        "gap": "rocker - crank - 2*5",
        "joint": [("crank", "theta"), ("coupler", "phi")],
        "transmission": "psi - phi",
        "height": lambda v: v.coupler * jnp.sin(jnp.deg2rad(v.phi)),
    }
    loop = [("crank", "theta"), ("coupler", "phi"), ("-rocker", "psi"), ("-ground", 0)]
    outputs = outputs_of(al.Assembly(LENGTHS, {"phi": 20, "psi": 90}, [loop], features=features))
    (phi, psi), joint = four_bar_in_closed_form()
    assert set(outputs) == {"phi", "psi", *features}
    np.testing.assert_allclose([outputs["phi"], outputs["psi"]], [phi, psi], rtol=1e-13)
    assert outputs["gap"] == 30.0
    np.testing.assert_allclose(outputs["joint"], [joint.real, joint.imag], rtol=1e-13)
    np.testing.assert_allclose(outputs["transmission"], psi - phi, rtol=1e-13)
    np.testing.assert_allclose(outputs["height"], 80 * np.sin(np.deg2rad(phi)), rtol=1e-13)


def test_a_stack_of_plates_needs_no_unknowns():
    model = al.Assembly(
        dimensions={"housing": al.Normal(31.0, 0.03), "plate": al.Normal(10.0, 0.01)},
        features={"gap": "housing - 3*plate"},
    )
    germ = np.array([[0.0, 0.0], [1.0, -2.0]])
    gaps = compiled(jax.vmap(lambda one: al.simulate(realise(model, one, jnp.zeros(0)))["gap"]))(germ)
    np.testing.assert_allclose(gaps, [[1.0], [31.03 - 3 * 9.98]], rtol=1e-13)
    assert solve_algebraic(al.Assembly({"x": 1.0})).converged
    assert explain_failure(al.Assembly({"x": 1.0})) == ""


@pytest.mark.slow
def test_loops_may_be_spatial():
    # A strut from the origin to a point in space: its length, azimuth and elevation.
    assembly = al.Assembly(
        dimensions={"x": 3.0, "y": 4.0, "z": 12.0},
        unknowns={"strut": 10.0, "azimuth": 40.0, "elevation": 50.0},
        loops=[[("x", 0), ("y", 90), ("z", (0, 90)), ("-strut", ("azimuth", "elevation"))]],
        features={"half_way": [("strut/2", ("azimuth", "elevation")), (0, "previous")]},
    )
    outputs = outputs_of(assembly)
    exact = [13.0, np.rad2deg(np.arctan2(4.0, 3.0)), np.rad2deg(np.arcsin(12 / 13))]
    np.testing.assert_allclose([outputs[name] for name in assembly.unknowns], exact, rtol=1e-13)
    np.testing.assert_allclose(outputs["half_way"], [1.5, 2.0, 6.0], rtol=1e-13)


FORMULAS = {
    "e - c": 5.0,
    " +c * (e + 1) ": 16.0,
    "2*c**3 / 4 - 1e1": -6.0,
    "e**-1 + pi": 1 / 7 + np.pi,
    "sqrt(e + c)": 3.0,
    "sin(30) + cos(60) + tan(45)": 2.0,
    "asin(0.5) + acos(0.5) + atan(1)": 135.0,
    4: 4.0,
    (lambda v: v.e * v.c): 14.0,
}


def test_formulas_are_read_as_written():
    features = {f"f{i}": formula for i, formula in enumerate(FORMULAS)}
    outputs = outputs_of(al.Assembly({"c": 2, "e": 7.0}, features=features))
    np.testing.assert_allclose([outputs[name] for name in features], list(FORMULAS.values()), rtol=1e-14)


@pytest.mark.parametrize(
    ("formula", "message"),
    [
        ("E - c", r"there is no 'E'; expected one of \['c', 'e'\]"),
        ("e ^ 2", "give a Python function"),
        (al.Normal(0.0, 1.0), "among the dimensions"),
        ([("c", "previous"), ("e", 0)], "vector 1: there is no 'previous'"),
    ],
)
def test_a_formula_that_cannot_be_read_is_refused_in_words(formula, message):
    with pytest.raises(al.ProblemError, match=f"Assembly, feature 'f'.*{message}"):
        al.Assembly({"c": 2.0, "e": 7.0}, features={"f": formula})


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"loops": [[("p", 0), ("q", 90), ("b", 45)]] * 2}, "received 4: 4 from 2 closed loops"),
        ({"loops": [[("p", 0), ("x", 90)]]}, r"loop 1, vector 2: there is no 'x'.*\['a', 'b', 'p', 'q'\]"),
        ({"unknowns": {"a": 1.0}}, "'a' names a dimension and a unknown"),
        ({"units": {"r": "mm"}}, r"\['r'\], which are not unknowns or features"),
    ],
)
def test_a_description_that_does_not_fit_together_is_refused_in_words(wrong, message):
    loops = [[("p", 0), ("q", 90), ("b", 200)]]
    right = {"dimensions": {"a": 3.0, "b": 4.0}, "unknowns": {"p": 1.0, "q": 1.0}, "loops": loops}
    with pytest.raises(al.ProblemError, match=f"Assembly.*{message}"):
        al.Assembly(**(right | wrong))
