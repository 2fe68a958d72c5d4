"""A process never runs out of room for compiled programs: beyond what the system allows, LLVM ends it by a signal."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import pytest

from aleator._core import programs
from aleator._core.compilation import Compiled
from aleator._core.mappings import mappings, most_mappings
from aleator._core.programs import Programs

linux = pytest.mark.skipif(mappings() == 0, reason="only Linux limits memory mappings, and counts them")

# More programs than the mappings that are left have room for.
MANY = """
import jax.numpy as jnp
from aleator._core import programs
from aleator._core.compilation import Compiled
from aleator._core.mappings import mappings

room = 600
programs.most_mappings = lambda: 2 * (start + room)
compiled = Compiled(lambda x: jnp.sort(jnp.sin(x)) @ jnp.cumsum(x))
start, largest, least = mappings(), 0, 10**9
for size in range(2, 62):
    compiled(jnp.ones(size))
    largest = max(largest, mappings() - start)
print(largest, compiled.compilations)
"""


@linux
def test_a_process_has_mappings_and_may_have_more():
    assert 10 < mappings() < most_mappings()


@pytest.mark.slow
@linux
def test_programs_unused_for_longest_give_way_before_there_is_no_room():
    done = subprocess.run([sys.executable, "-c", MANY], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    largest, compilations = map(int, done.stdout.split())
    assert compilations == 60
    # One more program than there is room for, at most.
    assert 300 < largest < 700


def test_the_older_half_goes_and_what_is_used_stays(monkeypatch):
    kept, counts = Programs(), iter([70, 30])
    monkeypatch.setattr(programs, "most_mappings", lambda: 100)
    monkeypatch.setattr(programs, "mappings", lambda: next(counts))
    for key in "abcd":
        program, is_new = kept.found(key)
        assert is_new
        program.trace(lambda: lambda: len)
    for key in "abc":
        program, is_new = kept.found(key)
        assert not is_new
        program._executable = len
    kept.make_room()
    assert [key in kept for key in "abcd"] == [False, False, True, True]  # what is not compiled yet takes no room


def test_what_jax_keeps_goes_where_ours_does_not_help(monkeypatch):
    cleared = []
    monkeypatch.setattr(programs, "most_mappings", lambda: 100)
    monkeypatch.setattr(programs, "mappings", lambda: 70 if not cleared else 40)
    monkeypatch.setattr(jax, "clear_caches", lambda: cleared.append(True))
    kept = Programs()
    kept.make_room()
    kept.make_room()
    assert cleared == [True]


def test_mappings_of_others_are_not_taken_for_ours_again_and_again(monkeypatch):
    cleared = []
    monkeypatch.setattr(programs, "most_mappings", lambda: 100)
    monkeypatch.setattr(programs, "mappings", lambda: 70)
    monkeypatch.setattr(jax, "clear_caches", lambda: cleared.append(True))
    kept = Programs()
    for _ in range(3):
        kept.make_room()
    assert cleared == [True]


def test_mappings_are_counted_at_each_program_only_where_room_is_short(monkeypatch):
    monkeypatch.setattr(programs, "most_mappings", lambda: 40_000)
    for taken, expected in ((15_000, 4), (19_500, 20)):
        counts, kept = iter([taken] * 20), Programs()
        monkeypatch.setattr(programs, "mappings", lambda counts=counts: next(counts))
        for _ in range(20):
            kept.make_room()
        assert 20 - len(list(counts)) == expected


def test_a_program_that_gave_way_is_compiled_again():
    compiled = Compiled(lambda x: 2 * x)
    assert float(compiled(jnp.asarray(1.0))) == 2.0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(programs, "PROGRAMS", Programs())
        patch.setattr("aleator._core.compilation.PROGRAMS", programs.PROGRAMS)
        assert float(compiled(jnp.asarray(3.0))) == 6.0
    assert compiled.compilations == 2


def test_only_so_many_are_kept():
    kept = Programs(most=2)
    for key in "abac":
        kept.found(key)
    assert [key in kept for key in "abc"] == [True, False, True]
