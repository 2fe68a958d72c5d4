"""Journals of black boxes, executors that run them, and functions in processes of their own."""

import signal
from concurrent.futures import ThreadPoolExecutor

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


def test_a_box_that_has_changed_is_run_again(tmp_path):
    journal = tmp_path / "runs.jsonl"
    al.expand(al.foreign.BlackBox(boxes.smooth, journal=journal), TWO, ORDER)

    def other(at):
        return {"y": 1.0 + at["x"], "v": np.zeros(3)}

    assert_same(al.expand(al.foreign.BlackBox(other, journal=journal), TWO, ORDER), directly(other))


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
