"""Journals of black boxes, executors that run them, and functions in processes of their own."""

import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from boxed_functions import FRESH, ORDER, TWO, Counted, assert_same, directly, odd, refused, until

import aleator as al
import black_boxes as boxes

# --- Journals --------------------------------------------------------------------------------------------------------


def test_a_second_call_goes_on_where_the_first_failed(tmp_path):
    counted = Counted(until(tmp_path / "repaired", odd(None)))
    box = al.foreign.BlackBox(counted)
    refused(box)
    assert counted.calls == 30
    (tmp_path / "repaired").touch()
    assert_same(al.expand(box, TWO, ORDER), directly())
    assert counted.calls == 31 + FRESH


def test_threads_finish_what_they_have_begun_and_nothing_is_run_twice(tmp_path):
    counted = Counted(until(tmp_path / "repaired", boxes.stiff))
    kept = {"journal": tmp_path / "runs.jsonl", "version": 1}
    with ThreadPoolExecutor(3) as executor:
        refused(al.foreign.BlackBox(counted, executor=executor, **kept))
    known = len((tmp_path / "runs.jsonl").read_text().splitlines()) - 1
    (tmp_path / "repaired").touch()
    before = counted.calls
    al.expand(al.foreign.BlackBox(counted, **kept), TWO, ORDER)
    assert known + counted.calls - before == 30 + FRESH


KILLED = """
import os, signal, sys
sys.path.insert(0, {folder!r})
import aleator as al
import black_boxes as boxes

calls = []

def dying(at):
    calls.append(at)
    if len(calls) == 20:
        os.kill(os.getpid(), signal.SIGKILL)
    return boxes.smooth(at)

two = {{"x": al.Uniform.bounds(-1.0, 1.0), "z": al.Uniform.bounds(1.0, 3.0)}}
box = al.foreign.BlackBox(dying, journal="runs.jsonl")
expanded = al.expand(box, two, al.Expansion(order=3))
print(len(calls), float(expanded["y"].mean).hex())
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGKILL")
def test_a_process_that_is_killed_loses_no_finished_sample(tmp_path):
    script = tmp_path / "analysis.py"
    script.write_text(KILLED.format(folder=str(Path(__file__).parents[1])))

    def run():
        return subprocess.run([sys.executable, script.name], cwd=tmp_path, capture_output=True, text=True)

    assert run().returncode == -signal.SIGKILL
    journal = tmp_path / "runs.jsonl"
    assert len(journal.read_text().splitlines()) == 1 + 19
    # The last line is cut off in the middle, as by a full disk: its sample runs again.
    journal.write_bytes(journal.read_bytes()[:-40])
    finished = run()
    assert finished.stdout.split() == ["14", float(directly()["y"].mean).hex()], finished.stderr


def test_a_box_that_has_changed_is_told_and_run_again(tmp_path):
    journal = tmp_path / "runs.jsonl"
    al.expand(al.foreign.BlackBox(boxes.smooth, journal=journal), TWO, ORDER)

    def other(at):
        return {"y": 1.0 + at["x"], "v": np.zeros(3)}

    with pytest.warns(al.SimulationWarning, match="32 of these samples by another box"):
        expanded = al.expand(al.foreign.BlackBox(other, journal=journal), TWO, ORDER)
    assert_same(expanded, directly(other))


def test_a_plain_number_of_the_model_is_part_of_a_sample(tmp_path):
    counted = Counted(lambda at: at["gain"] * at["x"])
    box = al.foreign.BlackBox(counted, journal=tmp_path / "runs.jsonl", version=1)
    spreads = [float(al.expand(box, TWO | {"gain": gain}).std) for gain in (1.0, 2.0, 1.0)]
    assert spreads[1] == pytest.approx(2 * spreads[0])
    assert counted.calls == 2 * (30 + FRESH)


def test_a_file_that_is_no_journal_is_refused_and_left_as_it_is(tmp_path):
    table = tmp_path / "results.csv"
    table.write_text("x,y\n1,2\n")
    with pytest.raises(al.ProblemError, match="whose first line is not a journal's"):
        al.foreign.BlackBox(boxes.smooth, journal=table)
    assert table.read_text() == "x,y\n1,2\n"


# --- Executors -------------------------------------------------------------------------------------------------------


def test_ctrl_c_leaves_what_has_finished(python_interrupts):
    def interrupted(at):
        if counted.calls == 10:
            signal.raise_signal(signal.SIGINT)
        return boxes.smooth(at)

    counted = Counted(interrupted)
    box = al.foreign.BlackBox(counted)
    with pytest.raises(KeyboardInterrupt):
        al.expand(box, TWO, ORDER)
    assert counted.calls == 10
    assert_same(al.expand(box, TWO, ORDER), directly())
    assert counted.calls == 31 + FRESH


# --- Functions in processes of their own -----------------------------------------------------------------------------


def test_a_function_in_a_process_of_its_own_returns_the_same():
    at = {"x": 0.3, "z": 2.0}
    returned = al.foreign.Isolated(boxes.smooth)(at)
    np.testing.assert_array_equal(returned["v"], boxes.smooth(at)["v"])
    assert returned["y"] == boxes.smooth(at)["y"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("function", "said"),
    [
        (al.foreign.Isolated(boxes.hanging, time_limit=0.5), "ended after its time limit of 0.5 s"),
        (al.foreign.Isolated(boxes.crash), "its process ended by itself, by exit code 3"),
    ],
)
def test_a_function_in_a_process_of_its_own_can_hang_crash_and_raise(function, said):
    with pytest.raises(al.SimulationError, match=said):
        function({"x": 1.0, "z": 3.0})
