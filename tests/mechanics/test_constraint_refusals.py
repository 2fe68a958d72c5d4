"""What is refused of constraints, in words, before anything is compiled; and problems on closed loops."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from closed_loops import NEAR, FourBar, SliderCrank, slider_crank_by_hand

import aleator as al

GRID = al.Grid(0.5, 20)
TURN = {"crank": al.PowerSeries(start=(0.3, 4.0), end=(3.0, 4.0))}


def refused(make):
    with pytest.raises(al.ProblemError) as caught:
        make()
    return str(caught.value)


def problem(system, grid=GRID, output="crank", **given):
    return al.Problem(system, grid=grid, minimize=al.terminal(output).mean, **given)


def forward(model, start=None, guess=None):
    return lambda: problem(al.ForwardDynamics(model, start=start, guess={"slider": 0.4} if guess is None else guess))


class Twice(SliderCrank):
    constraint_names = ("length", "height", "level")

    def constraint(self, q):
        length, height = super().constraint(q)
        return length, height, 2.0 * height


class Many(SliderCrank):
    constraint_names = ("length", "height", "level", "width")

    def constraint(self, q):
        return (*super().constraint(q), q[0], q[1])


class Unnamed(SliderCrank):
    constraint_names = ()


class Free(al.Lagrangian):
    names = ("x",)

    def kinetic_energy(self, q, v):
        return 0.5 * v[0] ** 2


class Mute(Free):
    constraint_names = ("end",)


class Rates(al.Accelerations):
    names = ("x",)
    constraint_names = ("end",)

    def accelerations(self, q, v, torque):
        return torque

    def constraint(self, q):
        return q


class Shape(SliderCrank):
    constraint_names = ("length",)


class Silent(SliderCrank):
    def constraint(self, q):
        return None


class Lost(FourBar):
    def closures(self):
        return (al.joints.Closure("pin", parent="coupler", child="piston", joint=al.joints.Ball()),)


class NoTuple(FourBar):
    def closures(self):
        return al.joints.Closure("pin", parent="coupler", child="rocker", joint=al.joints.Ball())


class Hung(al.Lagrangian):
    """A mass on a rod of length 1, whose height follows."""

    names = ("x", "y")
    constraint_names = ("rod",)

    def kinetic_energy(self, q, v):
        return 0.5 * v @ v

    def constraint(self, q) -> Any:
        return (q @ q - 1.0,)


class HungByItsLength(Hung):
    """Without a slope where x = y = 0."""

    def constraint(self, q):
        return (jnp.sqrt(q @ q) - 1.0,)


class Sprung(Hung):
    """Whose force is not finite where x = y = 0, which its constraint allows."""

    def potential_energy(self, q):
        return jnp.sqrt(q @ q)

    def constraint(self, q):
        return (q[0] - q[1],)


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (Hung, "no start near x = 0, y = 0 satisfies its constraints"),
        (HungByItsLength, "or their derivatives, are not finite at x = 0, y = 0"),
    ],
)
def test_a_start_that_is_not_found_names_the_guess_that_helps(model, said: str):
    for make in (
        lambda: al.simulate(al.ForwardDynamics(model()), GRID),
        lambda: problem(al.ForwardDynamics(model()), output="x"),
        lambda: al.simulate(al.InverseDynamics(model(), motion={"x": al.PowerSeries(start=(2.0,), end=(0.5,))}), GRID),
        lambda: al.simulate(al.HybridDynamics(model(), motion={"x": al.PowerSeries(start=(2.0,), end=(0.5,))}), GRID),
    ):
        told = refused(make)
        assert "guess=" in told
        assert "constraints" in told
    assert said in refused(lambda: al.simulate(al.ForwardDynamics(model()), GRID))
    found = al.simulate(al.ForwardDynamics(model(), start={"x": 0.6}, guess={"y": -0.8}), GRID)
    np.testing.assert_allclose(found["x"] ** 2 + found["y"] ** 2, 1.0, atol=1e-6)


def test_accelerations_that_are_not_finite_at_the_start_name_the_guess_that_helps():
    told = refused(lambda: problem(al.ForwardDynamics(Sprung()), output="x"))
    assert "right after the start (x = 0, y = 0): accelerations that are not finite there" in told
    assert "guess=" in told
    with pytest.warns(al.SimulationWarning, match="guess="):
        al.simulate(al.ForwardDynamics(Sprung()), GRID)
    assert np.isfinite(
        al.simulate(al.ForwardDynamics(Sprung(), guess={"x": 1.0, "y": 1.0}), al.Grid(0.1, 10))["x"]
    ).all()


REFUSED = {
    "lengths that do not reach": (
        forward(SliderCrank(a=0.5), {"crank": 0.9}),
        [r"no start near crank = 0.9, rod = 0, slider = 0.4", "length = ", "height = ", "guess"],
    ),
    "an uncertain length that does not reach": (
        forward(SliderCrank(a=al.Uniform(0.25, half_width=0.15)), {"crank": 1.5}),
        ["no start near crank = 1.5", "In the system with a = 0.4"],
    ),
    "a decided length that does not reach": (
        forward(SliderCrank(a=al.Decision(0.1, 0.05, 0.4)), {"crank": 1.5}),
        ["no start near crank = 1.5", "In the system with a = 0.4"],
    ),
    "redundant constraints": (
        forward(Twice()),
        ["redundant", "expected 3 that are independent", "rank is 2", "'height', 'level'", "Leave out 1"],
    ),
    "a planar loop closed in space": (
        lambda: problem(al.ForwardDynamics(FourBar(planar=False), guess=NEAR)),
        ["redundant", "rank is 2", "'pin_z'", "planar=True"],
    ),
    "more constraints than freedoms": (
        lambda: al.ForwardDynamics(Many()),
        ["at most as many constraints", "received 4 constraints (length, height, level, width) on 3 velocities"],
    ),
    "a singular posture": (
        lambda: problem(
            al.ForwardDynamics(FourBar(crank=0.2, coupler=0.4, rocker=0.2, ground=0.4), guess={"crank": 0.0})
        ),
        ["singular posture", "rank 1", "'pin_x' binds nothing"],
    ),
    "a dead centre that is kept": (
        forward(SliderCrank(), {"slider": 0.4}, {"crank": 0.3}),
        ["dead centre", "how 'crank', 'rod' follow"],
    ),
    "a dead centre on the way": (
        lambda: problem(al.InverseDynamics(SliderCrank(a=0.3), motion=TURN, guess={"slider": 0.6})),
        ["lose their rank", "between t = ", "dead centre"],
    ),
    "a length that ends the way": (
        lambda: problem(al.InverseDynamics(SliderCrank(a=0.31), motion=TURN, guess={"slider": 0.6})),
        ["cannot be obeyed beyond about t = ", "lengths that do not reach"],
    ),
    "a start of too much": (
        forward(SliderCrank(), {"crank": 0.9, "rod": -0.3}),
        ["a start of at most 1", "['crank', 'rod']", "guess"],
    ),
    "velocities of too much": (
        forward(SliderCrank(), {"crank_rate": 0.9, "rod_rate": -0.3}),
        ["a start of at most 1", "['crank_rate', 'rod_rate']"],
    ),
    "a guess of what is kept": (forward(SliderCrank(), {"crank": 0.9}, {"crank": 0.9}), ["no ['crank'] to start"]),
    "a guess without constraints": (
        lambda: al.ForwardDynamics(Free(), guess={"x": 1.0}),
        ["expected no guess", "no constraints"],
    ),
    "names without equations": (lambda: Mute(), ["constraint_names and constraint(q) together", "no constraint(q)"]),
    "equations without names": (lambda: Unnamed(), ["constraint_names and constraint(q) together"]),
    "accelerations alone": (lambda: Rates(), ["masses must be known", "al.Mechanical or al.Lagrangian"]),
    "more equations than names": (
        forward(Shape()),
        ["Shape.constraint(q): expected shape (1,); received (2,)"],
    ),
    "equations that are not returned": (forward(Silent()), ["Silent.constraint(q): expected real numbers", "None"]),
    "too many prescribed": (
        lambda: al.InverseDynamics(SliderCrank(), motion={**TURN, "rod": 0.1}),
        ["trajectories by name for 1 of ['crank', 'rod', 'slider']"],
    ),
    "prescribed beside constraints": (
        lambda: al.HybridDynamics(SliderCrank(), motion={**TURN, "rod": 0.1}),
        ["at most as many constraints", "of which 2 are prescribed"],
    ),
    "a closure of no body": (lambda: al.simulate(al.ForwardDynamics(Lost()), GRID), ["binds 'piston'", "no body"]),
    "closures that are none": (
        lambda: al.ForwardDynamics(NoTuple()),
        ["closures returns a tuple of al.joints.Closure"],
    ),
    "a closure with a spring": (
        lambda: al.joints.Closure("pin", parent="a", child="b", joint=al.joints.Revolute("z", stiffness=1.0)),
        ["without spring and damper"],
    ),
    "a closure with a rotor": (
        lambda: al.joints.Closure("pin", parent="a", child="b", joint=al.joints.Revolute("z", armature=1.0)),
        ["without spring and damper (and armature)"],
    ),
    "a closure of a body to itself": (
        lambda: al.joints.Closure("pin", parent="a", child="a", joint=al.joints.Ball()),
        ["expected two bodies; received 'a' twice"],
    ),
    "a closure that is free": (
        lambda: al.joints.Closure("pin", parent="a", child="b", joint=al.joints.Free()),  # type: ignore[arg-type]
        ["Closure 'pin': joint", "Ball or Fixed"],
    ),
    "a plane across no axis": (
        lambda: al.joints.Closure("pin", parent="a", child="b", joint=al.joints.Ball(), planar=True),
        ["planar=True with al.joints.Revolute"],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", REFUSED)
def test_is_refused_in_words(case):
    make, parts = REFUSED[case]
    message = refused(make)
    for part in parts:
        assert part in message


@pytest.mark.slow
def test_the_motion_of_a_driven_crank_is_planned_for_an_uncertain_rod():
    def motion(middle):
        return al.PowerSeries(start=(0.3, 0.0), end=(2.8, 0.0), middle=middle)

    grid = al.Grid(1.0, 20)
    model = SliderCrank(b=al.Uniform(0.3, half_width=0.02))
    planned = al.Problem(
        al.InverseDynamics(model, motion={"crank": motion(al.Decision(1.3, 1.0, 2.2))}, guess={"slider": 0.4}),
        grid=grid,
        minimize=al.objectives.effort("crank_torque"),
        subject_to=[al.path("height_multiplier").within(-9.0, 9.0, sigmas=2.0)],
        expansion=al.Expansion(order=3),
    )
    solution = al.solve(planned)
    assert solution.ok
    (middle,) = solution.vector
    # The same mean by hand, on finer instants, by Gauss' rule over the lengths of the rod.
    nodes, weights = np.polynomial.legendre.leggauss(6)
    fine = np.linspace(0.0, 1.0, 401)
    curve = [np.asarray(motion(middle).derivative(k).sampled(fine, 0.0, 1.0)) for k in range(3)]
    efforts = [np.trapezoid(slider_crank_by_hand(*curve, b=0.3 + 0.02 * one)["torque"] ** 2, fine) for one in nodes]
    assert solution.objective == pytest.approx(float(weights @ efforts) / 2, rel=1e-4)
