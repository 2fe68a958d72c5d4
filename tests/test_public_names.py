"""The package's face: what `import aleator` shows and what it loads."""

import pkgutil
import subprocess
import sys
import types
from collections import Counter

import pytest

import aleator as al


def public(module):
    """What a module shows, by name."""
    return {name: one for name, one in vars(module).items() if not name.startswith("_")}


TOPICS = (
    "cost",
    "fits",
    "index_sets",
    "integrators",
    "joints",
    "objectives",
    "points",
    "processes",
    "references",
    "results",
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


@pytest.mark.parametrize("topic", TOPICS)
def test_a_topic_shows_classes_and_functions_alone_and_says_what_it_is_for(topic):
    module = getattr(al, topic)
    assert module.__doc__
    assert all(callable(one) for one in public(module).values())


def test_no_name_is_in_two_topics_or_in_one_and_flat():
    places = Counter(name for topic in TOPICS for name in public(getattr(al, topic)))
    places.update(name for name, one in public(al).items() if not isinstance(one, types.ModuleType))
    assert [name for name, count in places.items() if count > 1] == []


def test_what_few_programs_need_is_not_loaded_with_the_package():
    late = [
        "scipy.stats",
        "scipy.optimize",
        "scipy.interpolate",
        "plotly",
        "pandas",
        "casadi",
        "typer",
        "h5py",
        "diffrax",
    ]
    script = f"import sys, aleator; print([name for name in {late} if name in sys.modules])"
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=True)
    assert found.stdout.strip() == "[]"
