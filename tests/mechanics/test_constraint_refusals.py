"""What is refused of constraints, in words, before anything is compiled; and problems on closed loops."""

from typing import Any

import jax.numpy as jnp
import pytest
from closed_loops import NEAR, FourBar, SliderCrank

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


def changed(base=SliderCrank, **parts):
    return type("Odd", (base,), parts)()


class Free(al.Lagrangian):
    names = ("x",)

    def kinetic_energy(self, q, v):
        return 0.5 * v[0] ** 2


class Rates(al.Accelerations):
    names = ("x",)

    def accelerations(self, q, v, torque):
        return torque


class Twice(SliderCrank):
    constraint_names = ("length", "height", "level")

    def constraint(self, q):
        length, height = super().constraint(q)
        return length, height, 2.0 * height


BALL = al.joints.Ball()


def closure(child="b", joint=BALL, **options):
    return al.joints.Closure("pin", parent="a", child=child, joint=joint, **options)


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
    told = refused(lambda: al.simulate(al.ForwardDynamics(model()), GRID))
    assert said in told
    assert "guess=" in told
    motion = {"x": al.PowerSeries(start=(2.0,), end=(0.5,))}
    assert "guess=" in refused(lambda: al.simulate(al.InverseDynamics(model(), motion=motion), GRID))
    assert "guess=" in refused(lambda: problem(al.ForwardDynamics(model()), output="x"))


def test_accelerations_that_are_not_finite_at_the_start_name_the_guess_that_helps():
    told = refused(lambda: problem(al.ForwardDynamics(Sprung()), output="x"))
    assert "right after the start (x = 0, y = 0): accelerations that are not finite there" in told
    assert "guess=" in told


REFUSED = {
    "lengths that do not reach": (
        forward(SliderCrank(a=0.5), {"crank": 0.9}),
        [r"no start near crank = 0.9, rod = 0, slider = 0.4", "length = ", "height = ", "guess"],
    ),
    "an uncertain length that does not reach": (
        forward(SliderCrank(a=al.Uniform(0.25, half_width=0.15)), {"crank": 1.5}),
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
        lambda: al.ForwardDynamics(changed(constraint_names=tuple("abcd"))),
        ["at most as many constraints", "received 4 constraints (a, b, c, d) on 3 velocities"],
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
    "a guess without constraints": (
        lambda: al.ForwardDynamics(Free(), guess={"x": 1.0}),
        ["expected no guess", "no constraints"],
    ),
    "names without equations": (
        lambda: changed(Free, constraint_names=("end",)),
        ["constraint_names and constraint(q) together", "no constraint(q)"],
    ),
    "equations without names": (lambda: changed(constraint_names=()), ["constraint_names and constraint(q) together"]),
    "accelerations alone": (
        lambda: changed(Rates, constraint_names=("end",), constraint=lambda self, q: q),
        ["masses must be known", "al.Mechanical or al.Lagrangian"],
    ),
    "more equations than names": (
        forward(changed(constraint_names=("length",))),
        ["Odd.constraint(q): expected shape (1,); received (2,)"],
    ),
    "too many prescribed": (
        lambda: al.InverseDynamics(SliderCrank(), motion={**TURN, "rod": 0.1}),
        ["trajectories by name for 1 of ['crank', 'rod', 'slider']"],
    ),
    "prescribed beside constraints": (
        lambda: al.HybridDynamics(SliderCrank(), motion={**TURN, "rod": 0.1}),
        ["at most as many constraints", "of which 2 are prescribed"],
    ),
    "a closure of no body": (
        lambda: al.simulate(al.ForwardDynamics(changed(FourBar, closures=lambda self: (closure(),))), GRID),
        ["no body"],
    ),
    "closures that are none": (
        lambda: al.ForwardDynamics(changed(FourBar, closures=lambda self: closure())),
        ["closures returns a tuple of al.joints.Closure"],
    ),
    "a closure with a rotor": (
        lambda: closure(joint=al.joints.Revolute("z", armature=1.0)),
        ["without spring and damper (and armature)"],
    ),
    "a closure of a body to itself": (lambda: closure("a"), ["expected two bodies; received 'a' twice"]),
    "a closure that is free": (lambda: closure(joint=al.joints.Free()), ["Closure 'pin': joint", "Ball or Fixed"]),
    "a plane across no axis": (lambda: closure(planar=True), ["planar=True with al.joints.Revolute"]),
}


SIMULATED = {
    "an uncertain length that does not reach",
    "a planar loop closed in space",
    "a singular posture",
    "a dead centre that is kept",
    "a dead centre on the way",
    "a length that ends the way",
    "more equations than names",
    "a closure of no body",
}
"""Cases that compile; two of their kind are looked at by default."""
CASES = [pytest.param(name, marks=pytest.mark.slow) if name in SIMULATED else name for name in REFUSED]


@pytest.mark.parametrize("case", CASES)
def test_is_refused_in_words(case):
    make, parts = REFUSED[case]
    message = refused(make)
    for part in parts:
        assert part in message
