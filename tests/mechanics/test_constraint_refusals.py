"""What is refused of constraints, in words, before anything is compiled."""

from typing import Any

import pytest
from closed_loops import SliderCrank

import aleator as al

GRID = al.Grid(0.5, 20)
TURN = {"crank": al.PowerSeries(start=(0.3, 4.0), end=(3.0, 4.0))}


def problem(system):
    return al.Problem(system, grid=GRID, minimize=al.terminal(system.model.coordinates[0]).mean)


def forward(model, start=None, guess=None):
    return lambda: problem(al.ForwardDynamics(model, start=start, guess={"slider": 0.4} if guess is None else guess))


class Hung(al.Lagrangian):
    """A mass on a rod of length 1, whose height follows."""

    names = ("x", "y")
    constraint_names = ("rod",)

    def kinetic_energy(self, q, v):
        return 0.5 * v @ v

    def constraint(self, q) -> Any:
        return (q @ q - 1.0,)


def twice():
    def constraint(self, q):
        length, height = SliderCrank.constraint(self, q)
        return length, height, 2.0 * height

    parts = {"constraint_names": ("length", "height", "level"), "constraint": constraint}
    return type("Odd", (SliderCrank,), parts)()


REFUSED = {
    "a start that is not found": (
        forward(Hung(), guess={}),
        ["no start near x = 0, y = 0 satisfies its constraints", "guess="],
    ),
    "redundant constraints": (
        forward(twice()),
        ["redundant", "expected 3 that are independent", "rank is 2", "'height', 'level'", "Leave out 1"],
    ),
    "a dead centre that is kept": (
        forward(SliderCrank(), {"slider": 0.4}, {"crank": 0.3}),
        ["dead centre", "how 'crank', 'rod' follow"],
    ),
    "a complete start that contradicts": (
        forward(Hung(), {"x": 0.5, "y": 0.5, "x_rate": 0.0, "y_rate": 0.0}, {}),
        ["names all coordinates", "contradicts its constraints", "rod = -0.5"],
    ),
    "a dead centre on the way": (
        lambda: problem(al.InverseDynamics(SliderCrank(a=0.3), motion=TURN, guess={"slider": 0.6})),
        ["lose their rank", "between t = ", "dead centre"],
    ),
    "a length that ends the way": (
        lambda: problem(al.InverseDynamics(SliderCrank(a=0.31), motion=TURN, guess={"slider": 0.6})),
        ["cannot be obeyed beyond about t = ", "lengths that do not reach"],
    ),
}


COMPILED = ("redundant constraints", "a complete start", "a dead centre", "a length that ends the way")
CASES = [pytest.param(name, marks=pytest.mark.slow) if name.startswith(COMPILED) else name for name in REFUSED]


@pytest.mark.parametrize("case", CASES)
def test_is_refused_in_words(case):
    make, parts = REFUSED[case]
    with pytest.raises(al.ProblemError) as caught:
        make()
    for part in parts:
        assert part in str(caught.value)
