"""What is uncertain or decided is told by its type, and what only holds numbers says so itself: names mean nothing."""

from typing import Any

import equinox as eqx
import numpy as np

import aleator as al
from aleator._core.leaves import highest, is_leaf, lowest, named_leaves
from aleator.uncertainty import placements, realise


class Range(eqx.Module):
    """A user's class whose fields are called like those of a decision."""

    initial: Any
    lower: Any
    upper: Any


class Oddity(eqx.Module):
    """A user's class that has all that a distribution has, by name."""

    distribution: Any = None
    parameters: Any = None
    shared_name: Any = None
    shape: Any = None

    def support(self):
        return 0.0, 1.0

    def germ(self):
        return None


def test_no_class_of_a_user_is_taken_for_a_leaf():
    for model in (Range(1.0, 0.0, 2.0), Oddity(), Oddity(distribution=Oddity())):
        assert not is_leaf(model)
        assert placements(model).entry_names() == ()
        assert placements(model).germ_names == ()


def test_leaves_inside_of_classes_that_look_like_leaves_are_found():
    look_alike = Range(al.Normal(1.0, 0.1), al.Decision(0.5, 0.0, 1.0), Oddity(shape=al.Uniform.bounds(0.0, 1.0)))
    model = {"a": (1.0, [look_alike])}
    found = placements(model)
    assert found.germ_names == ("a.1.0.initial", "a.1.0.upper.shape")
    assert found.entry_names() == ("a.1.0.lower",)
    realised = realise(model, np.array([1.0, 1.0]), np.array([0.25]))
    ((_, first), (_, second), (_, third)) = [pair for pair in named_leaves(realised) if eqx.is_array(pair[1])]
    np.testing.assert_allclose([first, second, third], [1.1, 0.25, 1.0])


def test_numbers_of_containers_that_say_so_go_by_their_own_names_at_any_depth():
    stack = al.Assembly({"a": al.Normal(1.0, 0.1), "b": al.Normal(2.0, 0.1)}, features={"gap": "b - a"})
    assert placements(stack).germ_names == ("a", "b")
    assert placements({"left": stack, "right": [stack]}).germ_names == ("left.a", "left.b", "right.0.a", "right.0.b")
    assert placements(
        al.Assembly({"dimensions": al.Normal(1.0, 0.1)}, features={"twice": "2*dimensions"})
    ).germ_names == ("dimensions",)


def test_every_number_tells_between_which_ends_it_lies():
    for number, *ends in [
        (np.array([1.0, 3.0]), 1.0, 3.0),
        ([al.Uniform.bounds(1.0, 4.0), 2.0], 1.0, 4.0),
        (al.Decision(np.ones(2), [0.0, 0.5], [3.0, 2.0]), 0.0, 3.0),
        (al.Uniform(al.Decision(1.0, 0.0, 5.0), half_width=al.Decision(0.5, 0.0, 2.0)), -2.0, 7.0),
    ]:
        np.testing.assert_allclose([lowest(number), highest(number)], ends, rtol=1e-12)
