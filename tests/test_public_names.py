"""The package's face: what `import aleator` shows and what it loads."""

import dataclasses
import re
import subprocess
import sys
import types
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
    "smooth",
    "solvers",
)


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


def test_every_class_that_a_result_holds_has_a_public_name():
    shown = {name for place in (al, extending, *(getattr(al, topic) for topic in TOPICS)) for name in public(place)}
    held = set()
    for result in filter(dataclasses.is_dataclass, (al.Solution, *public(al.results).values())):
        told = [field.type for field in dataclasses.fields(result)]
        told += [one.fget.__annotations__["return"] for one in vars(result).values() if isinstance(one, property)]
        held |= set(re.findall(r"aleator[\w.]*\.(\w+)", " ".join(map(str, told))))
    # What expressions and expansions are made of, which tell it in words.
    assert held - shown == {"Statistic", "Collocation", "PiecewiseBasis"}


def test_no_name_is_in_two_topics_or_in_one_and_flat():
    places = Counter(name for topic in TOPICS for name in public(getattr(al, topic)))
    places.update(name for name, one in public(al).items() if not isinstance(one, types.ModuleType))
    assert [name for name, count in places.items() if count > 1] == []


def test_little_is_loaded_with_the_package_and_numbers_have_64_bits_before_anything_is_used():
    late = ["scipy.stats", "scipy.optimize", "scipy.interpolate", "plotly", "pandas", "casadi", "h5py", "pint"]
    script = f"""
import sys, aleator as al, jax.numpy as jnp
print(jnp.ones(2).dtype)
first = [name for name in sys.modules if name.startswith("aleator.") and not name.startswith("aleator._core")]
al.Problem, al.solve, al.validate, al.Uniform, al.Multibody
print(first, [name for name in {[*late, "scipy.linalg", "fmpy"]} if name in sys.modules])
al.Probelm
"""
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=False)
    assert run.stdout.split("\n")[:2] == ["float64", "[] []"]
    assert run.stderr.strip().endswith("module 'aleator' has no attribute 'Probelm'. Did you mean: 'Problem'?")
