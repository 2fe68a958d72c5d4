"""The package's face: what `import aleator` shows and what it loads."""

import dataclasses
import pkgutil
import subprocess
import sys
import types
import typing
from collections import Counter

import aleator as al
from aleator import extending


def public(module):
    """What a module shows, by name."""
    return {name: getattr(module, name) for name in dir(module) if not name.startswith("_")}


TOPICS = (
    "cost",
    "expressions",
    "fits",
    "foreign",
    "index_sets",
    "integrators",
    "joints",
    "objectives",
    "points",
    "processes",
    "references",
    "results",
    "schemes",
    "shapes",
    "solvers",
)


def test_no_public_name_hides_a_module():
    hidden = [
        module.name
        for module in pkgutil.iter_modules(al.__path__)
        if not isinstance(getattr(al, module.name, types), types.ModuleType)
    ]
    assert hidden == []


def test_a_topic_shows_classes_and_functions_alone_and_says_what_it_is_for():
    for topic in TOPICS:
        module = getattr(al, topic)
        assert module.__doc__, topic
        assert all(callable(one) for one in public(module).values()), topic


def test_the_package_shows_its_topics_and_names_alone():
    modules = {name for name, one in public(al).items() if isinstance(one, types.ModuleType)}
    assert modules == {*TOPICS, "reporting"}
    assert {name for name in dir(al) if name.startswith("_")} == {"__version__"}


def test_what_is_shown_is_documented_and_ours():
    for place in (al, *(getattr(al, topic) for topic in TOPICS)):
        for name, one in public(place).items():
            assert isinstance(one, types.ModuleType) or one is al.Number or one.__module__.startswith("aleator"), name
            assert isinstance(one, types.ModuleType) or one.__doc__, name


def of_ours(hint):
    """The classes of this package in a type hint."""
    if isinstance(hint, type) and hint.__module__.startswith("aleator"):
        yield hint
    for part in typing.get_args(hint):
        yield from of_ours(part)


def told_by(kind):
    """The classes of this package that the fields and properties of a result hold."""
    names = vars(sys.modules[kind.__module__]) | {"Share": al.results.Proportion}
    hints = [one.type for one in dataclasses.fields(kind)]
    hints += [one.fget.__annotations__["return"] for one in vars(kind).values() if isinstance(one, property)]
    for hint in hints:
        yield from of_ours(eval(hint, dict(names)) if isinstance(hint, str) else hint)


def test_whatever_a_user_gets_in_hand_from_a_result_has_a_public_name():
    places = (al, extending, *(getattr(al, topic) for topic in TOPICS))
    shown = {one for place in places for one in public(place).values()}
    results = [one for one in (al.Solution, *public(al.results).values()) if dataclasses.is_dataclass(one)]
    missing = {held for one in results for held in told_by(one)} - shown
    # What expressions and expansions are made of, which tell it in words.
    assert {one.__name__ for one in missing} == {"Statistic", "Collocation", "Partition"}


def test_a_result_has_words_of_its_own_when_it_is_printed():
    assert [name for name, one in public(al.results).items() if one.__str__ is object.__str__] == []


def test_no_name_is_in_two_topics_or_in_one_and_flat():
    places = Counter(name for topic in TOPICS for name in public(getattr(al, topic)))
    places.update(name for name, one in public(al).items() if not isinstance(one, types.ModuleType))
    assert [name for name, count in places.items() if count > 1] == []


def test_little_is_loaded_with_the_package_and_numbers_have_64_bits_before_anything_is_used():
    late = ["scipy.stats", "scipy.optimize", "scipy.interpolate", "plotly", "pandas", "casadi", "typer", "h5py"]
    script = f"""
import sys, aleator as al, jax.numpy as jnp
print(jnp.ones(2).dtype)
first = [name for name in sys.modules if name.startswith("aleator.") and not name.startswith("aleator._core")]
al.Problem, al.solve, al.validate, al.Uniform, al.Multibody
print(first, [name for name in {[*late, "diffrax", "fmpy"]} if name in sys.modules])
al.Probelm
"""
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=False)
    assert run.stdout.split("\n")[:2] == ["float64", "[] []"]
    assert run.stderr.strip().endswith("module 'aleator' has no attribute 'Probelm'. Did you mean: 'Problem'?")


def test_a_star_import_brings_every_public_name():
    brought: dict[str, object] = {}
    exec("from aleator import *", brought)
    assert {"Problem", "Uniform", "solve", "expressions"} <= set(brought)
    assert brought["solve"] is al.solve
