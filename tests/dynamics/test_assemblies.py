import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator._core.arrays import numbers_to_arrays
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
    return jnp.stack([jnp.sqrt((e - c) ** 2 - (a + c) ** 2), jnp.rad2deg(jnp.arccos((a + c) / (e - c)))])


def dependent(dimensions):
    unknowns = solve_algebraic(clutch(*dimensions)).unknowns
    return jnp.stack([unknowns.b, unknowns.chi])


def outputs_of(assembly):
    """Each output at the one instant."""
    return {name: np.asarray(value[0]) for name, value in compiled(lambda: al.simulate(assembly))().items()}


def test_the_clutch_by_its_vector_loop_equals_its_closed_form():
    outputs = outputs_of(clutch(*NOMINAL))
    assert set(outputs) == {"b", "chi"}
    np.testing.assert_allclose([outputs["b"], outputs["chi"]], clutch_in_closed_form(*NOMINAL), rtol=1e-13)
    assert clutch(*NOMINAL).units == {"chi": "deg", "b": "mm"}


def test_sensitivities_of_the_clutch_are_those_by_hand():
    a, c, e = NOMINAL
    b, chi = np.asarray(clutch_in_closed_form(a, c, e))
    # (e - c) cos χ = a + c and b² = (e - c)² - (a + c)², differentiated.
    slope = np.rad2deg(1.0) / ((e - c) * np.sin(np.deg2rad(chi)))
    ratio = (a + c) / (e - c)
    by_hand = np.array([[-(a + c), -(a + e), e - c] / b, slope * np.array([-1.0, -1.0 - ratio, ratio])])
    point = jnp.asarray(NOMINAL)
    for jacobian in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(compiled(jacobian(dependent))(point), by_hand, rtol=1e-12)


def test_second_derivatives_of_the_clutch_are_those_of_the_closed_form():
    second = compiled(jax.hessian(dependent))(jnp.asarray(NOMINAL))
    exact = compiled(jax.hessian(lambda dimensions: clutch_in_closed_form(*dimensions)))(jnp.asarray(NOMINAL))
    np.testing.assert_allclose(second, exact, rtol=1e-11)


def test_the_spread_of_the_clutch_is_the_published_exact_value():
    # Gauss-Hermite quadrature over the three dimensions, 7 points each; studies.md: 3σ of χ is 0.6590101°.
    model = clutch(*map(al.Normal, NOMINAL, TOLERANCES / 3))
    assert placements(model).germ_names == ("a", "c", "e")
    points, weights = np.polynomial.hermite_e.hermegauss(7)
    germ = np.array(list(itertools.product(points, repeat=3)))
    weight = np.prod(list(itertools.product(weights / weights.sum(), repeat=3)), axis=1)
    angles = compiled(jax.vmap(lambda one: al.simulate(realise(model, one, jnp.zeros(0)))["chi"][0]))(germ)
    mean = weight @ angles
    assert 3 * np.sqrt(weight @ (angles - mean) ** 2) == pytest.approx(0.6590101, abs=5e-8)


def test_a_thousand_clutches_within_many_tolerances_move_continuously_with_their_dimensions():
    # Twelve times the tolerances and a sweep of the hub's height: χ from 2° to 15°, with a guess of 7° for all.
    random = np.random.default_rng(11)
    dimensions = NOMINAL + 12 * TOLERANCES * random.uniform(-1, 1, (1000, 3))
    sweep = np.stack([np.linspace(26.6, 27.9, 400), np.full(400, 11.43), np.full(400, 50.8)], axis=1)
    dimensions = np.concatenate([dimensions, sweep])
    dimensions = dimensions[(dimensions[:, 0] + 2 * dimensions[:, 1]) < dimensions[:, 2] - 0.02]
    solved = compiled(jax.vmap(lambda one: solve_algebraic(clutch(*one))))(dimensions)
    assert solved.converged.all()
    exact = np.asarray(clutch_in_closed_form(*dimensions.T)).T
    assert exact[:, 1].min() < 3 < 13 < exact[:, 1].max()
    np.testing.assert_allclose(solved.unknowns.chi, exact[:, 1], rtol=1e-12)
    np.testing.assert_allclose(solved.unknowns.b, exact[:, 0], rtol=1e-12)


def test_the_mirrored_clutch_is_found_from_a_mirrored_guess():
    outputs = outputs_of(al.Assembly(dict(zip("ace", NOMINAL, strict=True)), {"b": -4.8, "chi": -7}, [CLUTCH_LOOP]))
    np.testing.assert_allclose([outputs["b"], outputs["chi"]], -clutch_in_closed_form(*NOMINAL), rtol=1e-12)


def test_a_clutch_that_cannot_close_is_explained_by_its_dimensions_and_residual():
    # a + c > e - c
    too_high = clutch(28.5, 11.43, 50.8)
    assert np.isnan(outputs_of(too_high)["chi"]).all()
    message = explain_failure(too_high)
    assert message.startswith(
        "Assembly: Newton found no solution at a=28.5, c=11.43, e=50.8. From the guess b=4.8, chi=7"
    )
    assert "equation 2 of 2 is left with a residual of 0.5" in message
    assert explain_failure(clutch(*NOMINAL)) == ""


def test_a_clutch_at_its_dead_point_is_a_failure_that_speaks_of_a_singular_jacobian():
    # a + c = e - c: χ = 0, where the two mirrored solutions meet.
    dead = clutch(27.94, 11.43, 50.8)
    assert not solve_algebraic(dead).converged
    assert "the Jacobian is singular there" in explain_failure(dead)


def four_bar(guess, **options):
    """Ground 100, crank 30, coupler 80, rocker 70, from the crank's angle."""
    return al.Assembly(
        dimensions={"ground": 100, "crank": 30, "coupler": 80, "rocker": 70, "theta": 60},
        unknowns=guess,
        loops=[[("crank", "theta"), ("coupler", "phi"), ("-rocker", "psi"), ("-ground", 0)]],
        **options,
    )


def four_bar_in_closed_form(branch):
    """Angles of coupler and rocker in degrees, by the two circles around the moving ends."""
    pin = 30 * np.exp(1j * np.deg2rad(60.0))
    across = 100 - pin
    distance = abs(across)
    at_pin = np.arccos((80**2 + distance**2 - 70**2) / (2 * 80 * distance))
    joint = pin + 80 * np.exp(1j * (np.angle(across) + branch * at_pin))
    return np.rad2deg(np.angle([joint - pin, joint - 100]))


@pytest.mark.parametrize(("branch", "guess"), [(1, {"phi": 20, "psi": 90}), (-1, {"phi": -60, "psi": -100})])
def test_a_four_bar_linkage_has_two_solutions_each_from_its_guess(branch, guess):
    outputs = outputs_of(four_bar(guess))
    np.testing.assert_allclose([outputs["phi"], outputs["psi"]], four_bar_in_closed_form(branch), rtol=1e-13)


def test_angles_may_be_relative_to_the_vector_before_and_tied_by_an_equation():
    # The joints' turns in the place of directions; they add up to a full turn, back to the crank's own direction.
    assembly = al.Assembly(
        dimensions={"ground": 100, "crank": 30, "coupler": 80, "rocker": 70, "theta": 60},
        unknowns={"at_pin": -40, "at_joint": -110, "at_rocker": -90, "at_ground": -120},
        loops=[
            [
                ("crank", "theta"),
                ("coupler", "previous + at_pin"),
                ("rocker", "previous + at_joint"),
                ("ground", "previous + at_rocker"),
            ]
        ],
        equations=["at_pin + at_joint + at_rocker + at_ground = -360", "theta + at_pin + at_joint + at_rocker = -180"],
    )
    outputs = outputs_of(assembly)
    phi, psi = four_bar_in_closed_form(1)
    turns = [phi - 60, psi - 180 - phi, -psi, -120]
    np.testing.assert_allclose([outputs[name] for name in assembly.unknowns], turns, rtol=1e-13)


def test_open_loops_give_gaps_positions_and_angles():
    features = {
        "gap": "rocker - crank - 2*5",
        "joint": [("crank", "theta"), ("coupler", "phi")],
        "transmission": "psi - phi",
        "height": lambda v: v.coupler * jnp.sin(jnp.deg2rad(v.phi)),
    }
    outputs = outputs_of(four_bar({"phi": 20, "psi": 90}, features=features))
    phi, psi = four_bar_in_closed_form(1)
    joint = 100 + 70 * np.exp(1j * np.deg2rad(psi))
    assert set(outputs) == {"phi", "psi", *features}
    assert outputs["gap"] == 30.0
    np.testing.assert_allclose(outputs["joint"], [joint.real, joint.imag], rtol=1e-13)
    np.testing.assert_allclose(outputs["transmission"], psi - phi, rtol=1e-13)
    np.testing.assert_allclose(outputs["height"], 80 * np.sin(np.deg2rad(phi)), rtol=1e-13)


def test_a_stack_of_plates_needs_no_unknowns():
    model = al.Assembly(
        dimensions={"housing": al.Normal(31.0, 0.03), "plate": al.Normal(10.0, 0.01)},
        features={"gap": "housing - 3*plate"},
    )
    germ = jnp.array([[0.0, 0.0], [1.0, -2.0]])
    gaps = compiled(jax.vmap(lambda one: al.simulate(realise(model, one, jnp.zeros(0)))["gap"]))(germ)
    np.testing.assert_allclose(gaps, [[1.0], [31.03 - 3 * 9.98]], rtol=1e-13)
    assert solve_algebraic(al.Assembly({"x": 1.0})).converged
    assert explain_failure(al.Assembly({"x": 1.0})) == ""


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


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("e - c", 5.0),
        ("-c", -2.0),
        (" +c * (e + 1) ", 16.0),
        ("2*c**3 / 4 - 1e1", -6.0),
        ("e**-1 + pi", 1 / 7 + np.pi),
        ("sqrt(e + c)", 3.0),
        ("sin(30) + cos(60) + tan(45)", 2.0),
        ("asin(0.5) + acos(0.5) + atan(1)", 135.0),
        ("e", 7.0),
        (4, 4.0),
        (np.float64(0.5), 0.5),
        (lambda v: v.e * v.c, 14.0),
    ],
)
def test_formulas_are_read_as_written(formula, expected):
    assembly = al.Assembly({"c": 2, "e": 7.0}, features={"f": formula})
    np.testing.assert_allclose(al.simulate(assembly)["f"], [expected], rtol=1e-14)


@pytest.mark.parametrize(
    ("formula", "message"),
    [
        ("e - d", r"there is no 'd'; expected one of \['c', 'e'\]"),
        ("E - c", "there is no 'E'"),
        ("e ^ 2", r"received 'e \^ 2'.*give a Python function"),
        ("e -", r"'e -' is not an arithmetic expression"),
        ("", "is not an arithmetic expression"),
        ("e.real", r"received 'e\.real'"),
        ("__import__('os').system('x')", "received '__import__"),
        ("exp(e)", r"received 'exp\(e\)'"),
        ("sin(e, c)", r"received 'sin\(e, c\)'"),
        ("e if c else 0", "received 'e if c else 0'"),
        ("'e'", "received ''e''"),
        ("True", "received 'True'"),
        ("2j", "received '2j'"),
        ("previous + 90", "there is no 'previous'"),
        (np.nan, "expected a name, a finite number, an expression .* received nan"),
        (None, "received None"),
        (True, "received True"),
        (al.Normal(0.0, 1.0), "Put uncertain or decided numbers among the dimensions"),
        ([("c", 0)], "expected two or more vectors"),
        ([("c", 0), ("e", 0, 0)], r"vector 2: expected \(length, direction\)"),
        ([("c", 0), "e"], r"vector 2: expected \(length, direction\), such as \('a', 90\); received 'e'"),
        ([("c", "previous"), ("e", 0)], "vector 1: there is no 'previous'"),
        ([("c", (1, 2, 3)), ("e", 0)], r"vector 1: expected a direction in degrees or, in space"),
    ],
)
def test_a_formula_that_cannot_be_read_is_refused_in_words(formula, message):
    with pytest.raises(al.ProblemError, match=f"Assembly, feature 'f'.*{message}"):
        al.Assembly({"c": 2.0, "e": 7.0}, features={"f": formula})


SQUARE = [("a", 0), ("b", 90), ("-a", 0), ("-b", 90)]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"loops": []}, r"expected as many equations as unknowns, 2 for \['p', 'q'\]; received 0"),
        (
            {"loops": [[("p", 0), ("q", 90), ("b", 45)]] * 2},
            r"received 4: 4 from 2 closed loops .* and 0 others\. Add the missing equations",
        ),
        ({"loops": [[("p", 0), ("q", "180")]], "equations": ["p = q"]}, "2 from 1 closed loops .* and 1 others"),
        ({"loops": [SQUARE]}, "unknown 'p' is in no loop and no equation"),
        ({"loops": [[("p", 0)]]}, r"loop 1: expected two or more vectors, .* received \[\('p', 0\)\]"),
        ({"loops": [("p", 0)]}, r"loop 1, vector 1: expected \(length, direction\)"),
        ({"loops": ["pq"]}, "loop 1: expected two or more vectors"),
        (
            {"loops": [[("p", 0), ("x", 90)]]},
            r"loop 1, vector 2: there is no 'x'; expected one of \['a', 'b', 'p', 'q'\]",
        ),
        ({"equations": ["p = q = a", "p = a"]}, "equation 1: expected 'left = right'"),
        ({"equations": ["p = radius", "p = a"]}, "equation 1: there is no 'radius'"),
        ({"unknowns": {"a": 1.0}}, "'a' names a dimension and a unknown"),
        ({"features": {"p": "a"}}, "'p' names a unknown and a feature"),
        ({"unknowns": ["p", "q"]}, r"expected each unknown by name, in a dict; received \['p', 'q'\]"),
        ({"unknowns": {"p": al.Decision(1.0), "q": 1.0}}, "a finite number near its nominal value as the guess of 'p'"),
        ({"unknowns": {"p": np.nan, "q": 1.0}}, "the guess of 'p'; received nan"),
        ({"dimensions": {"a": "3", "b": 1.0}}, "a distribution or a decision as dimension 'a'; received '3'"),
        ({"dimensions": {"a": np.ones(2), "b": 1.0}}, "as dimension 'a'; received array"),
        ({"dimensions": {"a b": 1.0}}, "a dimension is named like a variable of Python.* received 'a b'"),
        ({"dimensions": {"lambda": 1.0}}, "received 'lambda'"),
        ({"dimensions": {"previous": 1.0}}, "received 'previous'"),
        ({"dimensions": {"_a": 1.0}}, "received '_a'"),
        ({"dimensions": {"µ": 1.0}}, "received 'µ'"),
        ({"units": {"r": "mm"}}, r"units are given for \['r'\], which are not unknowns or features"),
    ],
)
def test_a_description_that_does_not_fit_together_is_refused_in_words(wrong, message):
    right = {
        "dimensions": {"a": 3.0, "b": 4.0},
        "unknowns": {"p": 1.0, "q": 1.0},
        "loops": [[("p", 0), ("q", 90), ("b", 200)]],
    }
    if "equations" in wrong and "loops" not in wrong:
        right["loops"] = []
    with pytest.raises(al.ProblemError, match=f"Assembly.*{message}"):
        al.Assembly(**(right | wrong))


def test_values_that_are_no_single_numbers_are_refused_when_traced():
    with pytest.raises(al.ProblemError, match=r"a function gives one number; received shape \(2,\)"):
        al.simulate(al.Assembly({"a": 1.0}, features={"f": lambda v: v.a * jnp.ones(2)}))
    with pytest.raises(al.ProblemError, match=r"dimension 'a' is one number; received shape \(3,\)"):
        al.simulate(al.Assembly({"a": jnp.ones(3)}, features={"f": "a"}))


def test_dimensions_are_numbers_and_the_description_is_structure():
    first, second = (numbers_to_arrays(clutch(27.6 + shift, 11, 50.8)) for shift in (0.0, 0.1))
    assert jax.tree.structure(first) == jax.tree.structure(second)
    assert hash(jax.tree.structure(first)) == hash(jax.tree.structure(second))
    assert all(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(first))
    other = numbers_to_arrays(clutch(27.6, 11, 50.8, chi=6.0))
    assert jax.tree.structure(first) != jax.tree.structure(other)
