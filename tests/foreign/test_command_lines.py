"""Programs as black boxes: what they are given, what they write, and how they are ended."""

import math
import os
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import numpy as np
import pytest
from boxed_functions import ORDER, TWO, assert_same, directly, refused

import aleator as al

SMOOTH = """
import json, math, sys
x, z = {read}
print("starting")
print(json.dumps({{"y": math.exp(x) * z, "v": [x, z**2, 1.0]}}), file={where})
"""


@pytest.fixture
def script(tmp_path, monkeypatch):
    """Writes a script into the present folder, and gives a command that runs it without looking for packages."""
    monkeypatch.chdir(tmp_path)

    def write(text, *arguments, name="box.py", **options):
        (tmp_path / name).write_text(textwrap.dedent(text))
        return al.foreign.Command([sys.executable, "-I", "-S", name, *arguments], **options)

    return write


def exponential(at):
    """The function of the scripts, by the same library."""
    return {"y": math.exp(at["x"]) * at["z"], "v": np.array([at["x"], at["z"] ** 2, 1.0])}


def test_a_command_with_arguments_in_threads_gives_the_bits_of_the_function(script):
    command = script(SMOOTH.format(read="map(float, sys.argv[1:])", where="sys.stdout"), "{x}", "{z}")
    with ThreadPoolExecutor(2) as executor:
        assert_same(al.expand(al.foreign.BlackBox(command, executor=executor), TWO, ORDER), directly(exponential))


def test_a_command_with_files_in_folders_of_their_own_gives_the_bits_of_the_function(script):
    command = script(
        SMOOTH.format(read='(json.load(open("in.json"))[name] for name in "xz")', where='open("out.json", "x")'),
        input_file="in.json",
        output_file="out.json",
    )
    few = al.Expansion(2, points=al.points.GaussPoints(), tolerance=0.2)
    assert_same(al.expand(al.foreign.BlackBox(command), TWO, few), directly(exponential, few))
    assert sorted(path.name for path in Path().iterdir()) == ["box.py"]


@pytest.mark.parametrize(
    ("printed", "output"),
    [
        ("0\n[0.5, 0.1]\n[1.5, 2.5]", [1.5, 2.5]),
        ('{\n  "y": 1.5\n}\n', {"y": 1.5}),
    ],
)
def test_the_output_is_what_a_program_prints_last(script, printed, output):
    command = script(f"print({printed!r})", "--x={x}")
    assert jax.tree.map(np.ndarray.tolist, command({"x": 1.0})) == output


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("print('all is well')", "expected JSON in its standard output; received 'all is well'"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "it ended by the signal SIGSEGV; its stderr is"),
        ("import sys; sys.exit('mesh is tangled')", "exit code 1; its stderr ends with: mesh is tangled"),
    ],
)
def test_a_command_that_fails_is_told_by_sample_and_inputs(script, text, said):
    message = refused(al.foreign.BlackBox(script(text, "{x}", "{z}")), expansion=al.Expansion(1))
    assert said in message
    assert f"'{Path(sys.executable).name} box.py' failed at sample 1 (x=-0.888889, z=2)" in message


def test_a_changed_script_is_another_command(script, tmp_path):
    for factor in (1.0, 2.0):
        command = script(f"import sys; print({factor} * float(sys.argv[1]) + float(sys.argv[2]))", "{x}", "{z}")
        box = al.foreign.BlackBox(command, journal=tmp_path / "runs.jsonl")
        expanded = al.expand(box, TWO, al.Expansion(1))
        assert float(expanded.sobol("x")) == pytest.approx(factor**2 / (1 + factor**2))


HANGING = """
import fcntl, subprocess, sys
child = "import fcntl, time; file = open({lock!r}, 'w'); fcntl.flock(file, fcntl.LOCK_EX); time.sleep(100)"
child += "; open({survived!r}, 'w')"
subprocess.run([sys.executable, "-I", "-S", "-c", child])
"""


@pytest.mark.skipif(os.name == "nt", reason="locks of files are POSIX's")
def test_a_command_that_hangs_is_ended_with_its_children(script, tmp_path):
    import fcntl

    lock, survived = tmp_path / "lock", tmp_path / "survived"
    command = script(HANGING.format(lock=str(lock), survived=str(survived)), "{x}", "{z}", time_limit=2.0)
    message = refused(al.foreign.BlackBox(command))
    assert "failed at sample 1 (x=-0.966667, z=2): it was ended after its time limit of 2 s" in message
    with lock.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # waits for the child, unless it has been ended
    assert not survived.exists()
