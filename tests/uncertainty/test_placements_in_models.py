"""Placements and realisation: what is told by its type, how it is named and ordered, and what is one or two."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
import pytest

import aleator as al
from aleator._core.arrays import numbers_to_arrays
from aleator._core.errors import ProblemError
from aleator._core.leaves import highest, lowest
from aleator.uncertainty import (
    AbstractDistribution,
    Beta,
    Decision,
    Gamma,
    Normal,
    Uniform,
    at_means,
    named_numbers,
    placements,
    realise,
    uncertain_again,
)
from compiling import compiled


class Spring(eqx.Module):
    stiffness: Any
    damping: Any = 0.1


class Pair(NamedTuple):
    front: Any
    rear: Any


class Car(eqx.Module):
    mass: Any
    springs: Any
    settings: Any
    label: str = eqx.field(static=True, default="car")


def car():
    return Car(
        mass=Normal(1000.0, std=Decision(10.0, 1.0, 20.0)),
        springs=(
            Spring(Uniform(Decision(5.0, 1, 9), half_width=Decision(0.5, 0.1, 1.0)), Decision(0.3, 0, 1)),
            [Spring(Gamma(shape=2.0, scale=3.0)), 4.0],
        ),
        settings={
            "z": Beta(alpha=Decision(2.0, 1.0, 3.0), beta=5.0),
            "a": Pair(Uniform.bounds(Decision(1.0, 0.5, 1.5), 2.0), Decision(np.array([1.0, 2.0]))),
            "count": 3,
        },
    )


def rebuilt(model):
    leaves, structure = jax.tree.flatten(model)
    return jax.tree.unflatten(structure, leaves)


def test_distributions_and_decisions_are_found_anywhere_and_named_by_their_place():
    found = placements(car())
    assert " ".join(found.distributions) == (
        "mass springs.0.stiffness springs.1.0.stiffness settings.a.front settings.z"
    )
    assert " ".join(found.decisions) == (
        "mass.std springs.0.stiffness.mean springs.0.stiffness.half_width springs.0.damping settings.a.front.lower "
        "settings.a.rear settings.z.alpha"
    )


@pytest.mark.parametrize(
    "change", [lambda model: rebuilt(rebuilt(model)), numbers_to_arrays, lambda model: uncertain_again(at_means(model))]
)
def test_names_order_and_numbers_survive_flattening(change):
    before, after = placements(car()), placements(change(car()))
    assert tuple(after.distributions) == tuple(before.distributions)
    assert tuple(after.decisions) == tuple(before.decisions)
    for attribute in ("initial", "lower", "upper"):
        assert after.vector(attribute).tolist() == before.vector(attribute).tolist()
    assert [place.where for place in after.decisions.values()] == [place.where for place in before.decisions.values()]


def test_realisation_puts_numbers_at_the_decisions_everywhere_and_leaves_the_rest_alone():
    start = np.asarray(placements(car()).vector("initial"))
    moved = np.array([7.0, 6.0, 0.25, 0.9, 1.25, 8.0, 9.0, 2.0])
    model = numbers_to_arrays(car())
    dynamic, static = eqx.partition(model, eqx.is_array)
    germs = np.array([[1.0, -1.0, 6.0, 0.5, 0.0], [2.0, 1.0, 1.0, -1.0, 0.3]])
    mapped = compiled(jax.vmap(lambda germ, x: realise(eqx.combine(dynamic, static), germ, x)))
    real = mapped(germs, np.stack([start, moved]))
    assert not any(isinstance(leaf, AbstractDistribution | Decision) for leaf in jax.tree.leaves(real))
    assert real.mass.tolist() == [1010.0, 1014.0]
    assert real.springs[0].stiffness.tolist() == [4.5, 6.25]
    assert real.springs[0].damping.tolist() == [0.3, 0.9]
    assert real.springs[1][0].stiffness.tolist() == [18.0, 3.0]
    assert real.settings["a"].front.tolist() == [1.75, 1.25]
    assert real.settings["a"].rear.tolist() == [[1.0, 2.0], [8.0, 9.0]]
    assert float(real.settings["z"][0]) == pytest.approx(0.5, rel=1e-14)
    alone = realise(Car(2.0, (), {"count": 3}), np.zeros(0), np.zeros(0))
    assert (alone.label, alone.settings["count"], alone.mass) == ("car", 3, 2.0)


def test_a_shared_distribution_is_one_variable_wherever_it_is_placed():
    tilt = Normal(Decision(1.0, 0, 2), 2.0).shared("tilt")
    model = {"left": tilt, "right": [tilt, Normal(0.0, 1.0)]}
    for changed in (model, rebuilt(model), numbers_to_arrays(model)):
        places = placements(changed)
        assert tuple(places.distributions) == ("tilt", "right.1")
        assert tuple(places.decisions) == ("tilt.mean",)
    assert set(named_numbers(model, np.array([4.0]))) == {"tilt.mean", "tilt.std", "right.1.mean", "right.1.std"}
    real = realise(model, np.array([0.5, -1.0]), np.array([1.5]))
    assert (float(real["left"]), float(real["right"][0]), float(real["right"][1])) == (2.5, 2.5, -1.0)


def test_a_shared_decision_is_one_decision_wherever_it_is_placed():
    radius = Decision(np.array([1.0, 2.0]), 0.0, 3.0).shared("radius")
    k = Decision(3.0, 1.0, 5.0).shared("k")
    model = {"a": Uniform(k, half_width=1.0), "b": k, "c": radius, "d": radius, "e": Normal(0.0, k)}
    places = placements(model)
    assert tuple(places.decisions) == ("k", "radius")
    assert places.size == 3
    real = realise(model, np.array([1.0, 2.0]), np.array([4.0, 8.0, 9.0]))
    assert (float(real["a"]), float(real["b"]), float(real["e"])) == (5.0, 4.0, 8.0)
    assert real["c"].tolist() == real["d"].tolist() == [8.0, 9.0]


def test_one_shared_name_for_two_things_is_refused():
    for first, second in [
        (Normal(0.0, 1.0).shared("x"), Normal(0.0, 2.0).shared("x")),
        (Decision(1.0).shared("x"), Decision(1.0, lower=0.0).shared("x")),
        (Normal(Decision(1.0), 1.0).shared("x"), Normal(Decision(1.0, upper=9.0), 1.0).shared("x")),
        (Normal(0.0, 1.0).shared("x"), Decision(1.0).shared("x")),
    ]:
        with pytest.raises(ProblemError, match="'x' is shared by two placements that differ"):
            placements({"a": first, "b": second})


def test_two_independent_placements_that_happen_to_have_one_name_are_refused():
    for model in [
        {"a": Normal(0.0, 1.0).shared("b"), "b": Normal(0.0, 1.0)},
        {"a.b": Normal(0.0, 1.0), "a": {"b": Normal(0.0, 1.0)}},
        {"a": Decision(1.0, 0.0, 10.0).shared("c"), "c": 50.0},
        {"a": Decision(1.0).shared("c.0"), "c": [50.0]},
        {"a": Decision(1.0).shared("c.std"), "c": Normal(0.0, 1.0)},
    ]:
        with pytest.raises(ProblemError, match="names two placements"):
            placements(model)


def test_at_means_realises_the_means_at_the_current_decisions():
    model = at_means(
        {"a": Uniform.bounds(Decision(1.0, upper=2.5), 3.0), "b": Gamma(shape=2.0, scale=Decision(3.0, 0.0)), "c": 5.0}
    )
    real = compiled(lambda x: realise(model, np.zeros(0), x))(np.array([2.0, 4.0]))
    assert (float(real["a"]), float(real["b"]), real["c"]) == (2.5, 8.0, 5.0)


def test_at_means_twice_is_at_means_once_and_uncertain_again_undoes_it():
    once = at_means(car())
    assert placements(once).distributions == {}
    assert tuple(placements(once).decisions) == tuple(placements(car()).decisions)
    assert eqx.tree_equal(at_means(once), once)
    assert eqx.tree_equal(uncertain_again(once), car())
    assert eqx.tree_equal(uncertain_again(car()), car())


def test_named_numbers_hold_places_parameters_and_moments_at_the_current_decisions():
    model = {"k": Uniform(Decision(5.0), half_width=3.0), "m": 2.0, "v": np.array([1.0, 2.0]), "d": Decision(1.0)}
    for changed in (model, at_means(model)):
        numbers = named_numbers(changed, np.array([9.0, 6.0]))
        assert {name: np.asarray(value).tolist() for name, value in numbers.items()} == {
            "d": 9.0,
            "k.mean": 6.0,
            "k.std": pytest.approx(np.sqrt(3.0), rel=1e-14),
            "k.half_width": 3.0,
            "m": 2.0,
            "v": [1.0, 2.0],
        }


def test_a_decision_is_unbounded_unless_told_and_bounds_of_an_array_may_be_one_for_all_or_one_each():
    assert (Decision(2).lower, Decision(2).upper) == (-np.inf, np.inf)
    places = placements({"x": Decision(np.array([1.0, 2.0]), lower=0.0, upper=np.array([3.0, 4.0]))})
    assert places.vector("lower").tolist() == [0.0, 0.0]
    assert places.vector("upper").tolist() == [3.0, 4.0]


def test_array_decisions_fill_the_vector_and_are_named_entry_by_entry():
    places = placements({"a": Decision(7.0), "b": Decision(np.arange(6.0).reshape(2, 3)), "c": Decision(np.ones(1))})
    assert places.size == 8
    assert places.vector("initial").tolist() == [7, 0, 1, 2, 3, 4, 5, 1]
    assert places.entry_names() == ("a", "b[0]", "b[1]", "b[2]", "b[3]", "b[4]", "b[5]", "c[0]")
    named = places.named(np.arange(10.0, 18.0))
    assert named["a"] == 10.0
    assert named["b"].tolist() == [[11, 12, 13], [14, 15, 16]]
    assert named["c"].tolist() == [17]


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


@dataclass
class Section:
    """Numbers of an object that JAX takes for one value."""

    width: float


@pytest.mark.parametrize(
    "part", [{"a", "b"}, Section(1.0), np.array(["a", "b"]), np.array([al.Normal(0.0, 1.0)], object)]
)
def test_what_no_program_can_take_is_refused_by_its_place(part):
    with pytest.raises(al.ProblemError, match=r"'part': expected numbers.*received"):
        placements({"part": part})


class Beam(al.AlgebraicSystem):
    """A beam whose section is unpacked in the order in which it is written."""

    section: dict[str, Any]

    def outputs(self):
        height, base = self.section.values()
        return {"I": base * height**3 / 12, "A": base * height}


def test_models_and_functions_see_dicts_in_the_order_in_which_they_are_written():
    section = {"height": al.Decision(2.0, 0.5, 3.0), "base": al.Decision(1.0, 0.2, 3.0)}
    problem = al.Problem(Beam(section), minimize=al.output("A").mean, subject_to=[al.output("I").mean >= 1.0])
    assert al.solve(problem).decisions == {"section.height": pytest.approx(3.0), "section.base": pytest.approx(4 / 9)}

    def gap(parts):
        first, *others = parts.values()
        return first - sum(others)

    stack = {"shaft": al.Normal(10.0, 0.1), "ring": al.Normal(3.0, 0.2)}
    assert al.expand(gap, stack, traced=False).mean == pytest.approx(7.0)
    found = al.references.monte_carlo(gap, stack, samples=64, traced=False)
    assert found.mean.value == pytest.approx(7.0, abs=0.2)
    assert al.tolerance_analysis(stack, gap, lower=6.0, upper=8.0).worst_case == pytest.approx((6.1, 7.9))
