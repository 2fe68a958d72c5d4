"""Systems of equations without time: solutions, derivatives, failures, and what is refused."""

import re
from functools import cache
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
from zoo import Bar, derivative_error

RK4 = al.integrators.RungeKutta4()


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


def slider(crank, rod, angle, xp=np):
    """The slider's position in closed form."""
    return crank * xp.cos(angle) + xp.sqrt(rod**2 - crank**2 * xp.sin(angle) ** 2)


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
    both = compiled(lambda: (al.simulate(SliderCrank(), al.Instant(), {}, RK4), al.simulate(SliderCrank())))
    outputs, same = both()
    assert set(outputs) == {"x", "rod_angle"}
    assert outputs["x"].shape == (1,)
    np.testing.assert_allclose(outputs["x"], [slider(0.03, 0.08, 0.7)], rtol=1e-14)
    np.testing.assert_allclose(outputs["rod_angle"], [np.arcsin(0.03 * np.sin(0.7) / 0.08)], rtol=1e-14)
    assert float(same["x"][0]) == float(outputs["x"][0])
    assert al.Instant().times.tolist() == [0.0]


def test_unknowns_may_be_arrays_and_have_derivatives():
    def equations(vector):
        stretch = np.diff(np.concatenate([[0.0], vector, [2.0]]))
        return np.diff(3.0 * np.arange(1.0, 7.0) * (stretch + stretch**3))

    def places(parameters):
        outputs = al.simulate(Springs(*parameters))
        return jnp.concatenate([outputs["places"][0], outputs["force"], outputs["one"]])

    both = compiled(lambda x: (places(x), jax.jacrev(places)(x)))
    point = np.array([3.0, 2.0])
    values, jacobian = both(point)
    reference = root(equations, np.linspace(0.2, 1.8, 5), tol=1e-14).x
    np.testing.assert_allclose(values[:5], reference, rtol=1e-11)
    assert values[6] == 1.0
    assert derivative_error(lambda x: np.asarray(both(x)[0]), jacobian, point) < 1e-9


def test_a_thousand_points_are_solved_at_once():
    random = np.random.default_rng(5)
    cranks, rods, angles = random.uniform([[0.02], [0.06], [-3.0]], [[0.04], [0.1], [3.0]], (3, 1000))
    solve = compiled(jax.vmap(lambda *parameters: solve_algebraic(SliderCrank(*parameters))))
    solved = jax.tree.map(np.asarray, solve(cranks, rods, angles))
    assert solved.converged.all()
    assert solved.residual_norm.max() < 1e-13
    np.testing.assert_allclose(solved.unknowns.x, slider(cranks, rods, angles), rtol=1e-13)


def test_derivatives_are_those_of_the_closed_form():
    def position(parameters):
        return al.simulate(SliderCrank(*parameters))["x"][0]

    def exact(parameters):
        return slider(*parameters, xp=jnp)

    @compiled
    def all_of(x):
        return (
            (jax.grad(position)(x), jax.jacfwd(position)(x), jax.hessian(position)(x)),
            (jax.grad(exact)(x), jax.hessian(exact)(x)),
        )

    (backward, forward, curvature), (slope, second) = all_of(np.array([0.03, 0.08, 0.7]))
    np.testing.assert_allclose(backward, slope, rtol=1e-13)
    np.testing.assert_allclose(forward, slope, rtol=1e-13)
    np.testing.assert_allclose(curvature, second, rtol=1e-12)


class Parabola(al.AlgebraicSystem):
    """`x² = level`, from a guess; an output would hide a number that is none."""

    unknowns = ("x",)

    level: Any = 4.0
    start: Any = 1.0

    def guess(self):
        return {"x": self.start}

    def residual(self, rho):
        return (rho.x**2 - self.level,)

    def outputs(self, rho):
        return {"x": rho.x, "side": jnp.where(rho.x > 0, 1.0, -1.0)}


@cache
def parabolas():
    """Values, slopes and curvatures by the level, for many levels and guesses at once."""

    def at(level, start):
        def x(level):
            return al.simulate(Parabola(level, start))["x"][0]

        return al.simulate(Parabola(level, start)), jax.grad(x)(level), jax.grad(jax.grad(x))(level)

    levels, starts = np.array([4.0, 4.0, 4.0, -4.0, 0.0, 9.0]), np.array([1.0, 5.0, -0.5, 1.0, 1.0, 9.0])
    return jax.tree.map(np.asarray, compiled(jax.vmap(at))(levels, starts))


def test_of_two_solutions_it_is_the_one_on_the_side_of_the_guess():
    assert parabolas()[0]["x"][:3, 0].tolist() == [2.0, 2.0, -2.0]


def test_a_guess_that_depends_on_parameters_leaves_no_trace_in_derivatives():
    _, slope, curvature = parabolas()
    np.testing.assert_allclose([slope[-1], curvature[-1]], [1 / 6, -1 / 108], rtol=1e-13)


def test_where_there_is_no_solution_outputs_are_not_a_number_and_the_other_points_stay():
    outputs = parabolas()[0]
    for name in ("x", "side"):
        assert np.isnan(outputs[name][:, 0]).tolist() == [False, False, False, True, True, False]


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
        (Parabola(4), "^$"),
        (Bar(1.0, 2.0), "^$"),
    ],
)
def test_a_failure_is_explained_by_its_point_and_residual(system, message):
    assert re.search(message, explain_failure(system))


def algebraic(guess=lambda: {"x": 1.0, "y": 1.0}, residual=lambda z: (z.x - 1.0, z.y - 1.0), outputs=lambda z: {}):
    class Model(al.AlgebraicSystem):
        unknowns = ("x", "y")

        def guess(self):
            return guess()

        def residual(self, rho):
            return residual(rho)

        def outputs(self, rho):
            return outputs(rho)

    return Model()


def declared(**parts: Any) -> Any:
    return type("Odd", (al.AlgebraicSystem,), parts)()


GUESS, RESIDUAL = lambda self: {"x": 1.0}, lambda self, rho: (rho.x - 1.0,)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: algebraic(guess=lambda: {"x": 1.0}), r"Model\.guess returns a dict .*\('x', 'y'\); received"),
        (lambda: algebraic(guess=lambda: (1.0, 1.0)), r"Model\.guess returns a dict .* received \(1\.0, 1\.0\)"),
        (
            lambda: algebraic(residual=lambda z: (z.x,)),
            r"Model\.residual: expected as many equations .*, 2; received 1",
        ),
        (lambda: algebraic(residual=lambda z: z.x - 1.0), "an array of shape"),
        (lambda: algebraic(residual=lambda z: {"x": z.x}), "as a tuple.*received dict"),
        (lambda: algebraic(residual=lambda z: (z.x if z.x > 0 else 0.0, z.y)), "branches on a number"),
        (lambda: algebraic(outputs=lambda z: z.x), r"Model\.outputs returns a dict of arrays by name"),
        (lambda: declared(outputs=lambda self: 1.0), r"Odd\.outputs returns a dict"),
        (lambda: declared(), r"Odd declares no outputs: expected outputs\(self\), or unknowns"),
        (lambda: declared(unknowns=("x",)), "declares unknowns, but not guess and residual"),
        (lambda: declared(unknowns=("x",), residual=RESIDUAL), "declares unknowns and residual, but not guess:"),
        (lambda: declared(unknowns=("x",), guess=GUESS), "declares unknowns and guess, but not residual:"),
        (lambda: declared(unknowns=(), guess=GUESS, residual=RESIDUAL), "guess and residual, but not unknowns:"),
        (lambda: declared(outputs=lambda self, rho: {}), r"outputs\(self\), for a class without unknowns"),
        (
            lambda: declared(unknowns=("x",), guess=GUESS, residual=RESIDUAL, outputs=lambda self: {}),
            r"outputs\(self, rho\), for a class with unknowns; received outputs\(self\)",
        ),
    ],
)
def test_declarations_that_do_not_fit_together_are_refused_in_words(wrong, message):
    with pytest.raises(al.ProblemError, match=message):
        al.simulate(wrong())


def test_unknowns_may_be_a_field_or_a_property():
    class Many(al.AlgebraicSystem):
        unknowns: tuple[str, ...]

        def guess(self):
            return dict.fromkeys(self.unknowns, 1.0)

        def residual(self, rho):
            return [value - 2.0 for value in rho]

    outputs = compiled(lambda: al.simulate(Many(("x", "y"))))()
    assert {name: float(value[0]) for name, value in outputs.items()} == {"x": 2.0, "y": 2.0}


def test_a_system_of_equations_refuses_time_and_inputs():
    with pytest.raises(al.ProblemError, match=r"Parabola is algebraic, without time: expected al\.Instant\(\).*Grid"):
        al.simulate(Parabola(), al.Grid(1.0, 1))
    with pytest.raises(al.ProblemError, match=r"Parabola is algebraic and takes no inputs; received \['road'\]"):
        al.simulate(Parabola(), inputs={"road": al.Tabulated([0.0, 1.0], [0.0, 1.0])})


def test_parameters_may_be_uncertain_and_decided():
    model = SliderCrank(crank=al.Uniform(0.03, half_width=0.001), rod=al.Decision(0.08, 0.05, 0.1))
    assert placements(model).germ_names == ("crank",)
    assert placements(model).entry_names() == ("rod",)

    def position(germ, decisions):
        return al.simulate(realise(model, germ, decisions))["x"][0]

    both = compiled(jax.vmap(jax.value_and_grad(position, argnums=1), in_axes=(0, None)))
    positions, slopes = both(np.array([[-0.5], [0.5]]), np.array([0.09]))
    cranks = np.array([0.0295, 0.0305])
    np.testing.assert_allclose(positions, slider(cranks, 0.09, 0.7), rtol=1e-14)
    np.testing.assert_allclose(slopes[:, 0], 0.09 / np.sqrt(0.09**2 - (cranks * np.sin(0.7)) ** 2), rtol=1e-13)


def test_the_traced_equations_are_the_same_text_each_time():
    # A problem's digest is taken of them: else each declaration would compile anew.
    texts = [str(jax.make_jaxpr(lambda angle: al.simulate(SliderCrank(angle=angle)))(0.7)) for _ in range(2)]
    assert texts[0] == texts[1]
