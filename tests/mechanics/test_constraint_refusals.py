"""What is refused of constraints, in words, before anything is compiled; and problems on closed loops."""

from typing import Any

import jax.numpy as jnp
import pytest
from closed_loops import ClosedTree, SliderCrank

import aleator as al
from zoo import Pendulum

GRID = al.Grid(0.5, 20)
TURN = {"crank": al.PowerSeries(start=(0.3, 4.0), end=(3.0, 4.0))}


def problem(system, output="crank"):
    return al.Problem(system, grid=GRID, minimize=al.terminal(output).mean)


def forward(model, start=None, guess=None):
    return lambda: problem(al.ForwardDynamics(model, start=start, guess={"slider": 0.4} if guess is None else guess))


def changed(base=SliderCrank, **parts):
    return type("Odd", (base,), parts)()


def closure(child="b", joint=al.joints.Ball(), **options):  # noqa: B008
    return al.joints.Closure("pin", parent="a", child=child, joint=joint, **options)


class Hung(al.Lagrangian):
    """A mass on a rod of length 1, whose height follows."""

    names = ("x", "y")
    constraint_names = ("rod",)

    def kinetic_energy(self, q, v):
        return 0.5 * v @ v

    def constraint(self, q) -> Any:
        return (q @ q - 1.0,)


def length(self, q):
    return (jnp.sqrt(q @ q) - 1.0,)


def sprung():
    """Whose force is not finite where x = y = 0, which its constraint allows."""
    parts = {"potential_energy": lambda self, q: jnp.sqrt(q @ q), "constraint": lambda self, q: (q[0] - q[1],)}
    return changed(Hung, **parts)


def twice():
    def constraint(self, q):
        length, height = SliderCrank.constraint(self, q)
        return length, height, 2.0 * height

    return changed(constraint_names=("length", "height", "level"), constraint=constraint)


REFUSED = {
    "a start that is not found": (
        lambda: al.simulate(al.ForwardDynamics(Hung()), GRID),
        ["no start near x = 0, y = 0 satisfies its constraints", "guess="],
    ),
    "a start without a slope": (
        lambda: al.simulate(al.ForwardDynamics(changed(Hung, constraint=length)), GRID),
        ["or their derivatives, are not finite at x = 0, y = 0", "guess="],
    ),
    "accelerations that are not finite": (
        lambda: problem(al.ForwardDynamics(sprung()), output="x"),
        ["right after the start (x = 0, y = 0): accelerations that are not finite there", "guess="],
    ),
    "lengths that do not reach": (
        forward(SliderCrank(a=0.5), {"crank": 0.9}),
        [r"no start near crank = 0.9, rod = 0, slider = 0.4", "length = ", "height = ", "guess"],
    ),
    "redundant constraints": (
        forward(twice()),
        ["redundant", "expected 3 that are independent", "rank is 2", "'height', 'level'", "Leave out 1"],
    ),
    "a planar loop closed in space": (
        lambda: problem(al.ForwardDynamics(ClosedTree(planar=False), guess={"slider": 0.4})),
        ["redundant", "rank is 2", "'pin_z'", "planar=True"],
    ),
    "more constraints than freedoms": (
        lambda: al.ForwardDynamics(changed(constraint_names=tuple("abcd"))),
        ["at most as many constraints", "received 4 constraints (a, b, c, d) on 3 velocities"],
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
    "a guess without constraints": (
        lambda: al.ForwardDynamics(Pendulum(), guess={"angle": 1.0}),
        ["expected no guess", "no constraints"],
    ),
    "more equations than names": (
        forward(changed(constraint_names=("length",))),
        ["Odd.constraint(q): expected shape (1,); received (2,)"],
    ),
    "a closure with a rotor": (
        lambda: closure(joint=al.joints.Revolute("z", armature=1.0)),
        ["without spring and damper (and armature)"],
    ),
    "equations without names": (lambda: changed(constraint_names=()), ["constraint_names and constraint(q) together"]),
    "a closure of a body to itself": (lambda: closure("a"), ["expected two bodies; received 'a' twice"]),
    "a plane across no axis": (lambda: closure(planar=True), ["planar=True with al.joints.Revolute"]),
}


COMPILED = ("a planar loop", "a dead centre", "a length that ends the way")
CASES = [pytest.param(name, marks=pytest.mark.slow) if name.startswith(COMPILED) else name for name in REFUSED]


@pytest.mark.parametrize("case", CASES)
def test_is_refused_in_words(case):
    make, parts = REFUSED[case]
    with pytest.raises(al.ProblemError) as caught:
        make()
    for part in parts:
        assert part in str(caught.value)
