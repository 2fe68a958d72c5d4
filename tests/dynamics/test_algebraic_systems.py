import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import root

import aleator as al
from aleator.dynamics import explain_failure, solve_algebraic
from aleator.uncertainty import placements, realise
from compiling import compiled
from tiny_models import derivative_error


class SliderCrank(al.AlgebraicSystem):
    """A crank and a rod (m) that push a slider: angles in radians beside lengths in metres."""

    unknowns = ("x", "rod_angle")

    crank: Any = 0.03
    rod: Any = 0.08
    angle: Any = 0.7

    def guess(self):
        return {"x": 0.1, "rod_angle": 0.2}

    def residual(self, rho):
        return (
            self.crank * jnp.cos(self.angle) + self.rod * jnp.cos(rho.rod_angle) - rho.x,
            self.crank * jnp.sin(self.angle) - self.rod * jnp.sin(rho.rod_angle),
        )


def slider(crank, rod, angle):
    """The slider's position in closed form."""
    return crank * np.cos(angle) + np.sqrt(rod**2 - crank**2 * np.sin(angle) ** 2)


class Springs(al.AlgebraicSystem):
    """Masses in a row between hardening springs: one unknown that is an array, and one number."""

    unknowns = ("places", "force")

    stiffness: Any = 3.0
    end: Any = 2.0

    def guess(self):
        return {"places": jnp.linspace(0.2, 1.8, 5), "force": 1}

    def residual(self, rho):
        walls = jnp.concatenate([jnp.zeros(1), rho.places, jnp.reshape(jnp.asarray(self.end), (1,))])
        stretch = jnp.diff(walls)
        tension = self.stiffness * jnp.arange(1.0, 7.0) * (stretch + stretch**3)
        return jnp.diff(tension), rho.force - tension[-1]

    def outputs(self, rho):
        return {"places": rho.places, "force": rho.force, "one": 1}


def test_a_system_of_equations_has_its_unknowns_as_outputs_at_one_instant():
    outputs = al.simulate(SliderCrank())
    assert list(outputs) == ["x", "rod_angle"]
    assert outputs["x"].shape == (1,)
    np.testing.assert_allclose(outputs["x"], [slider(0.03, 0.08, 0.7)], rtol=1e-14)
    np.testing.assert_allclose(outputs["rod_angle"], [np.arcsin(0.03 * np.sin(0.7) / 0.08)], rtol=1e-14)
    same = al.simulate(SliderCrank(), al.Instant(), {}, al.integrators.RungeKutta4())
    assert {name: value.tolist() for name, value in same.items()} == {
        name: value.tolist() for name, value in outputs.items()
    }


def test_unknowns_may_be_arrays():
    system = Springs()

    def equations(vector):
        stretch = np.diff(np.concatenate([[0.0], vector, [2.0]]))
        return np.diff(3.0 * np.arange(1.0, 7.0) * (stretch + stretch**3))

    reference = root(equations, np.linspace(0.2, 1.8, 5), tol=1e-14).x
    outputs, solved = compiled(lambda: (al.simulate(system), solve_algebraic(system)))()
    assert outputs["places"].shape == (1, 5)
    np.testing.assert_allclose(outputs["places"][0], reference, rtol=1e-11)
    assert outputs["one"].tolist() == [1.0]
    assert solved.converged
    assert float(solved.residual_norm) < 1e-14


def test_a_thousand_points_are_solved_at_once():
    random = np.random.default_rng(5)
    cranks, rods, angles = random.uniform([[0.02], [0.06], [-3.0]], [[0.04], [0.1], [3.0]], (3, 1000))
    solve = compiled(jax.vmap(lambda *parameters: solve_algebraic(SliderCrank(*parameters))))
    solved = solve(cranks, rods, angles)
    assert solved.converged.all()
    assert float(solved.residual_norm.max()) < 1e-13
    np.testing.assert_allclose(solved.unknowns.x, slider(cranks, rods, angles), rtol=1e-13)


def test_derivatives_are_those_of_the_closed_form():
    point = jnp.array([0.03, 0.08, 0.7])

    def position(parameters):
        return al.simulate(SliderCrank(*parameters))["x"][0]

    def exact(parameters):
        crank, rod, angle = parameters
        return crank * jnp.cos(angle) + jnp.sqrt(rod**2 - (crank * jnp.sin(angle)) ** 2)

    slope, curvature = compiled(lambda point: (jax.grad(exact)(point), jax.hessian(exact)(point)))(point)
    for gradient in (jax.grad, jax.jacfwd):
        np.testing.assert_allclose(compiled(gradient(position))(point), slope, rtol=1e-13)
    np.testing.assert_allclose(compiled(jax.hessian(position))(point), curvature, rtol=1e-12)


def test_derivatives_of_arrays_of_unknowns_agree_with_central_differences():
    def places(parameters):
        stiffness, end = parameters
        outputs = al.simulate(Springs(stiffness, end))
        return jnp.concatenate([outputs["places"][0], outputs["force"]])

    point = np.array([3.0, 2.0])
    function = compiled(places)
    assert derivative_error(function, compiled(jax.jacrev(places))(point), point) < 1e-9


class Parabola(al.AlgebraicSystem):
    """`x² = level`, from a guess."""

    unknowns = ("x",)

    level: Any = 4.0
    start: Any = 1.0

    def guess(self):
        return {"x": self.start}

    def residual(self, rho):
        return (rho.x**2 - self.level,)


def test_of_two_solutions_it_is_the_one_on_the_side_of_the_guess():
    found = compiled(jax.vmap(lambda start: al.simulate(Parabola(4.0, start))["x"][0]))(jnp.array([1.0, 5.0, -0.5]))
    assert found.tolist() == [2.0, 2.0, -2.0]


def test_a_guess_may_depend_on_the_parameters_and_leaves_no_trace_in_derivatives():
    def at(level):
        return al.simulate(Parabola(level, start=level))["x"][0]

    slope, curvature = compiled(lambda level: (jax.grad(at)(level), jax.grad(jax.grad(at))(level)))(9.0)
    np.testing.assert_allclose(slope, 1 / 6, rtol=1e-14)
    np.testing.assert_allclose(curvature, -1 / 108, rtol=1e-13)


def test_where_there_is_no_solution_outputs_are_not_a_number_and_the_other_points_stay():
    class Signed(al.AlgebraicSystem):
        unknowns = ("x",)
        level: Any

        def guess(self):
            return {"x": 1.0}

        def residual(self, rho):
            return (rho.x**2 - self.level,)

        def outputs(self, rho):
            # An output that would hide a number that is none.
            return {"x": rho.x, "side": jnp.where(rho.x > 0, 1.0, -1.0)}

    outputs = compiled(jax.vmap(lambda level: al.simulate(Signed(level))))(jnp.array([4.0, -4.0, 0.0]))
    assert np.isnan(outputs["side"][:, 0]).tolist() == [False, True, True]
    assert np.isnan(outputs["x"][:, 0]).tolist() == [False, True, True]
    assert outputs["x"][0, 0] == 2.0


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (
            SliderCrank(crank=0.1, rod=0.05, angle=1.5),
            r"SliderCrank: Newton found no solution at crank=0\.1, rod=0\.05, angle=1\.5\. From the guess x=0\.1, "
            r"rod_angle=0\.2 it reached in \d+ steps x=.*, rod_angle=.*, where equation 2 of 2 is left with a residual "
            r"of 0\.0\d+.*Check whether a solution exists there, and guess closer to it\.$",
        ),
        (Parabola(0.0), r"at level=0, start=1\..*the Jacobian is singular there: .* or two solutions meet"),
        (Parabola(np.nan), r"at level=nan.* equation 1 of 1 is left with a residual of nan, which is not a finite"),
        (Parabola(4), ""),
    ],
)
def test_a_failure_is_explained_by_its_point_and_residual(system, message):
    text = explain_failure(system)
    assert re.search(message, text) if message else text == ""


def algebraic(
    guess=lambda: {"x": 1.0, "y": 1.0}, residual=lambda z: (z.x - 1.0, z.y - 1.0), outputs=lambda z: {"x": z.x}
):
    class Model(al.AlgebraicSystem):
        unknowns = ("x", "y")

        def guess(self):
            return guess()

        def residual(self, rho):
            return residual(rho)

        def outputs(self, rho):
            return outputs(rho)

    return Model()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"guess": lambda: {"x": 1.0}},
            r"Model\.guess returns a dict with a number for each of .*\('x', 'y'\); received",
        ),
        ({"guess": lambda: {"x": 1.0, "y": 1.0, "z": 1.0}}, r"Model\.guess returns a dict"),
        ({"guess": lambda: (1.0, 1.0)}, r"Model\.guess returns a dict .* received \(1\.0, 1\.0\)"),
        ({"residual": lambda z: (z.x,)}, r"Model\.residual: expected as many equations .*, 2; received 1"),
        ({"residual": lambda z: (z.x, z.y, z.x)}, ", 2; received 3"),
        ({"residual": lambda z: z.x - 1.0}, r"Model\.residual returns the equations.*an array of shape \(\)"),
        ({"residual": lambda z: {"x": z.x}}, "as a tuple.*received dict"),
        ({"residual": lambda z: None}, "as a tuple.*received NoneType"),
        ({"residual": lambda z: (z.x if z.x > 0 else 0.0, z.y)}, r"Model\.residual branches on a number"),
        ({"outputs": lambda z: z.x}, r"Model\.outputs returns a dict of arrays by name"),
    ],
)
def test_equations_that_do_not_fit_together_are_refused_in_words(wrong, message):
    with pytest.raises(al.ProblemError, match=message):
        al.simulate(algebraic(**wrong))


class Area(al.AlgebraicSystem):
    """A closed formula: outputs and nothing else."""

    width: Any = 2.0
    height: Any = 3.0

    def outputs(self):
        return {"area": self.width * self.height}


def test_closed_formulas_take_outputs_alone():
    assert float(al.simulate(Area())["area"][0]) == 6.0
    assert float(jax.grad(lambda width: al.simulate(Area(width))["area"][0])(5.0)) == 3.0
    solved = solve_algebraic(Area())
    assert tuple(solved.unknowns) == ()
    assert bool(solved.converged)
    assert explain_failure(Area()) == ""
    with pytest.raises(al.ProblemError, match=r"Odd\.outputs returns a dict"):
        al.simulate(declared(outputs=lambda self: 1.0))


def declared(**parts: Any) -> Any:
    return type("Odd", (al.AlgebraicSystem,), parts)()


GUESS, RESIDUAL = lambda self: {"x": 1.0}, lambda self, rho: (rho.x - 1.0,)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({}, r"Odd declares no outputs: expected outputs\(self\), or unknowns with guess and residual"),
        (
            {"unknowns": ("x",)},
            "Odd declares unknowns, but not guess and residual: implicit equations need all three, and",
        ),
        ({"unknowns": ("x",), "residual": RESIDUAL}, "Odd declares unknowns and residual, but not guess:"),
        ({"unknowns": ("x",), "guess": GUESS}, "Odd declares unknowns and guess, but not residual:"),
        ({"unknowns": ("x",), "outputs": lambda self, rho: {}}, "Odd declares unknowns, but not guess and residual:"),
        ({"guess": GUESS, "residual": RESIDUAL}, "Odd declares guess and residual, but not unknowns:"),
        ({"unknowns": (), "guess": GUESS, "residual": RESIDUAL}, "Odd declares guess and residual, but not unknowns:"),
        ({"outputs": lambda self, rho: {}}, r"expected outputs\(self\), for a class without unknowns; .*\(self, rho\)"),
        (
            {"unknowns": ("x",), "guess": GUESS, "residual": RESIDUAL, "outputs": lambda self: {}},
            r"Odd\.outputs: expected outputs\(self, rho\), for a class with unknowns; received outputs\(self\)",
        ),
    ],
)
def test_half_a_declaration_is_refused_in_one_sentence(parts, message):
    with pytest.raises(al.ProblemError, match=message):
        declared(**parts)


def test_unknowns_may_be_a_field_or_a_property():
    class Many(al.AlgebraicSystem):
        unknowns: tuple[str, ...]

        def guess(self):
            return dict.fromkeys(self.unknowns, 1.0)

        def residual(self, rho):
            return [value - 2.0 for value in rho]

    found = al.simulate(Many(("x", "y")))
    assert {name: float(value[0]) for name, value in found.items()} == {"x": 2.0, "y": 2.0}


def test_a_system_of_equations_refuses_time_and_inputs():
    with pytest.raises(al.ProblemError, match=r"Parabola is algebraic, without time: expected al\.Instant\(\).*Grid"):
        al.simulate(Parabola(), al.Grid(1.0, 1))
    with pytest.raises(al.ProblemError, match=r"Parabola is algebraic and takes no inputs; received \['road'\]"):
        al.simulate(Parabola(), inputs={"road": al.Tabulated([0.0, 1.0], [0.0, 1.0])})


class Still(al.System):
    states = ("x",)

    def rhs(self, t, z):
        return (0.0,)

    def outputs(self, t, z):
        return {"x": z.x}


@pytest.mark.parametrize("grid", [None, al.Instant()])
def test_a_system_that_moves_needs_a_grid_in_time(grid):
    with pytest.raises(al.ProblemError, match=r"Still evolves in time: expected a grid, such as al\.Grid"):
        al.simulate(Still(), grid)


def test_an_instant_is_one_moment():
    assert al.Instant().times.tolist() == [0.0]


def test_parameters_may_be_uncertain_and_decided():
    model = SliderCrank(crank=al.Uniform(0.03, half_width=0.001), rod=al.Decision(0.08, 0.05, 0.1))
    assert placements(model).germ_names == ("crank",)
    assert placements(model).entry_names() == ("rod",)

    def position(germ, decisions):
        return al.simulate(realise(model, germ, decisions))["x"][0]

    germ, decisions = jnp.array([[-0.5], [0.5]]), jnp.array([0.09])
    positions = compiled(jax.vmap(position, in_axes=(0, None)))(germ, decisions)
    np.testing.assert_allclose(positions, slider(np.array([0.0295, 0.0305]), 0.09, 0.7), rtol=1e-14)
    slope = compiled(jax.grad(position, argnums=1))(germ[0], decisions)[0]
    np.testing.assert_allclose(slope, 0.09 / np.sqrt(0.09**2 - (0.0295 * np.sin(0.7)) ** 2), rtol=1e-13)


def test_the_traced_equations_are_the_same_text_each_time():
    # A problem's digest is taken of them: else each declaration would compile anew.
    texts = [str(jax.make_jaxpr(lambda angle: al.simulate(SliderCrank(angle=angle)))(0.7)) for _ in range(2)]
    assert texts[0] == texts[1]
