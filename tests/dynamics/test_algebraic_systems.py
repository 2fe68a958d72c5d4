"""Systems of equations without time: solutions, derivatives, failures, and what is refused."""

import re
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.dynamics import explain_failure
from compiling import compiled


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


def test_a_system_of_equations_has_its_unknowns_as_outputs_at_one_instant():
    outputs = al.simulate(SliderCrank())
    assert set(outputs) == {"x", "rod_angle"}
    assert outputs["x"].shape == (1,)
    np.testing.assert_allclose(outputs["x"], [slider(0.03, 0.08, 0.7)], rtol=1e-14)
    np.testing.assert_allclose(outputs["rod_angle"], [np.arcsin(0.03 * np.sin(0.7) / 0.08)], rtol=1e-14)


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
    ],
)
def test_a_failure_is_explained_by_its_point_and_residual(system, message):
    assert re.search(message, explain_failure(system))


GUESS, RESIDUAL = lambda self: {"x": 1.0}, lambda self, rho: (rho.x - 1.0,)


def declared(**parts: Any) -> Any:
    return type("Odd", (al.AlgebraicSystem,), parts)()


def changed(**parts: Any) -> Any:
    return declared(**({"unknowns": ("x",), "guess": GUESS, "residual": RESIDUAL} | parts))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: changed(guess=lambda self: {"y": 1.0}), r"Odd\.guess returns a dict .*\('x',\); received"),
        (
            lambda: changed(outputs=lambda self: {}),
            r"outputs\(self, rho\), for a class with unknowns; received",
        ),
        (lambda: declared(), r"Odd declares no outputs: expected outputs\(self\), or unknowns"),
    ],
)
def test_declarations_that_do_not_fit_together_are_refused_in_words(wrong, message):
    with pytest.raises(al.ProblemError, match=message):
        al.simulate(wrong())
