"""Compiled programs are kept between runs: found again, bounded, and never in the way."""

import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import aleator as al
from aleator._core import kept_programs

# Compiles a function and says how often a program was found, and what it gives.
SCRIPT = """
import resource, sys
import jax
found = []
jax.monitoring.register_event_listener(lambda name, **_: found.append(name.endswith("cache_hits")))
{before}
import aleator as al
import jax.numpy as jnp
print(sum(found), float(jax.jit(lambda x: jnp.sum(jnp.sin(x) ** 2))(jnp.arange(4.0))), sum(found))
"""
VALUE = 1.5548  # the sum of the squared sines of 0, 1, 2 and 3 to four digits


def environment(**more):
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "ALEATOR_"))}
    return kept | more


def began(folder, before="", **more):
    script = SCRIPT.format(before=before)
    own = environment(ALEATOR_CACHE=str(folder), **more)
    return subprocess.Popen(
        [sys.executable, "-c", script], env=own, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def ended(process):
    """How often a program was found, and what was said beside it."""
    out, said = process.communicate(timeout=120)
    assert process.returncode == 0, said
    _, value, hits = out.split()
    assert float(value) == pytest.approx(VALUE, abs=1e-3)
    return int(hits), said


def entries(folder):
    return sorted(Path(folder).glob("*/*-cache"))


def test_the_sum_is_what_it_should_be():
    assert sum(math.sin(k) ** 2 for k in range(4)) == pytest.approx(VALUE, abs=1e-3)


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """A folder of programs that one run has compiled."""
    folder = tmp_path_factory.mktemp("filled")
    assert ended(began(folder)) == (0, "")
    assert entries(folder)
    return folder


def test_another_run_finds_what_one_has_compiled(filled):
    hits, said = ended(began(filled))
    assert hits >= 1
    assert said == ""


# Solves a problem with two decided parameters of distributions, and says how many programs had to be compiled.
SOLVED = """
import warnings
import jax
asked = []
jax.monitoring.register_event_listener(lambda name, **_: asked.append(name.split("/")[-1]))
import aleator as al
from aleator.studies.suspension import robust_problem
warnings.simplefilter("ignore")
al.solve(robust_problem())
print(asked.count("compile_requests_use_cache") - asked.count("cache_hits"))
"""


@pytest.mark.slow
def test_another_run_compiles_nothing_whatever_python_orders_sets_by(tmp_path):
    def compiled(seed):
        own = environment(ALEATOR_CACHE=str(tmp_path), PYTHONHASHSEED=seed)
        run = subprocess.run(
            [sys.executable, "-c", SOLVED], env=own, capture_output=True, text=True, check=True, timeout=600
        )
        return int(run.stdout)

    # By these two, a set of two names was ordered differently.
    assert compiled("1") > 0
    assert compiled("3") == 0


def test_damaged_programs_are_compiled_again_without_a_word(filled, tmp_path):
    shutil.copytree(filled, tmp_path, dirs_exist_ok=True)
    for i, path in enumerate(entries(tmp_path)):
        whole = path.read_bytes()
        path.write_bytes([whole[: len(whole) // 2], b"", b"another program's file", whole[::-1]][i % 4])
    assert ended(began(tmp_path)) == (0, "")


def test_two_runs_at_once_do_not_disturb_one_another(tmp_path):
    both = [began(tmp_path) for _ in range(2)]
    assert [ended(one)[1] for one in both] == ["", ""]
    assert ended(began(tmp_path))[0] >= 1


@pytest.mark.skipif(sys.platform == "win32", reason="files of limited size are known to POSIX systems")
def test_a_full_disk_keeps_nothing_and_stops_nothing(tmp_path):
    limited = "resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))"
    assert ended(began(tmp_path, limited)) == (0, "")
    assert ended(began(tmp_path)) == (0, "")


def test_it_can_be_turned_off(tmp_path):
    own = {"XDG_CACHE_HOME": str(tmp_path), "HOME": str(tmp_path), "LOCALAPPDATA": str(tmp_path)}
    assert ended(began("off", **own)) == (0, "")
    assert not list(tmp_path.rglob("*-cache"))


@pytest.mark.parametrize("off", ["off", "Off ", "no", "0", "false", ""])
def test_each_word_for_off_keeps_nothing(off, monkeypatch, tmp_path):
    monkeypatch.setenv(kept_programs.VARIABLE, off)
    monkeypatch.chdir(tmp_path)
    before = kept_programs.jax.config.jax_compilation_cache_dir
    kept_programs.keep_by_default()
    assert kept_programs.jax.config.jax_compilation_cache_dir == before
    assert not list(tmp_path.iterdir())


def test_a_folder_that_jax_was_given_stays(tmp_path):
    own = environment(JAX_COMPILATION_CACHE_DIR=str(tmp_path / "jax"), XDG_CACHE_HOME=str(tmp_path / "own"))
    script = "import jax, aleator; print(jax.config.jax_compilation_cache_dir)"
    found = subprocess.run([sys.executable, "-c", script], env=own, capture_output=True, text=True, timeout=120)
    assert found.stdout.strip() == str(tmp_path / "jax")
    assert not (tmp_path / "own").exists()


def test_a_folder_that_cannot_be_made_is_warned_of_in_one_sentence(tmp_path):
    (tmp_path / "file").write_text("no folder")
    hits, said = ended(began(tmp_path / "file"))
    assert hits == 0
    assert "ALEATOR_CACHE: Compiled programs cannot be kept in" in said
    assert "Not a directory" in said
    with pytest.raises(al.ProblemError, match=r"cannot be kept in .*file': Not a directory"):
        al.compilation_cache(tmp_path / "file")


@pytest.mark.parametrize("folder", ["~nobody-of-this-name/programs", "zero\0byte"])
def test_a_folder_that_cannot_be_is_refused_in_one_sentence(folder):
    with pytest.raises(al.ProblemError, match="cannot be kept in"):
        al.compilation_cache(folder)


def test_where_nobody_knows_the_home_nothing_is_kept(monkeypatch):
    def unknown(name):
        raise RuntimeError(f"no home, and so no {name}")

    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.delenv(kept_programs.VARIABLE, raising=False)
    monkeypatch.setattr(kept_programs.platformdirs, "user_cache_path", unknown)
    before = kept_programs.jax.config.jax_compilation_cache_dir
    kept_programs.jax.config.update("jax_compilation_cache_dir", None)
    try:
        kept_programs.keep_by_default()
        assert kept_programs.jax.config.jax_compilation_cache_dir is None
    finally:
        kept_programs.jax.config.update("jax_compilation_cache_dir", before)


def test_a_relative_folder_stays_where_it_was(tmp_path):
    moved = f"import os; os.chdir({str(tmp_path / 'b')!r})\nimport jax.numpy"
    script = SCRIPT.format(before="").replace("import jax.numpy", moved)
    (tmp_path / "b").mkdir()
    own = environment(ALEATOR_CACHE="programs")
    subprocess.run([sys.executable, "-c", script], env=own, cwd=tmp_path, check=True, capture_output=True, timeout=120)
    assert entries(tmp_path / "programs")
    assert not list((tmp_path / "b").iterdir())


def test_the_programs_unused_for_longest_are_forgotten(tmp_path, monkeypatch):
    monkeypatch.setattr(kept_programs, "_MOST_BYTES", 250)
    folder = tmp_path / kept_programs._kind()
    folder.mkdir()
    for age, name in enumerate(("newest", "new", "old", "oldest")):
        path = folder / f"{name}-cache"
        path.write_bytes(bytes(100))
        os.utime(path, (1e9 - age, 1e9 - age))
    kept_programs._forget_oldest(folder)
    assert sorted(path.name for path in folder.iterdir()) == ["new-cache", "newest-cache"]
