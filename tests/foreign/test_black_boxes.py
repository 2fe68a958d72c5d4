"""Black boxes against the same functions called directly, bit by bit; and what becomes of samples that fail."""

import json
import math
import multiprocessing
import os
import queue
import re
import signal
import subprocess
import sys
import textwrap
import threading
import warnings
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import jax
import numpy as np
import pytest

import aleator as al
import black_boxes as boxes
from tiny_models import Decay

TWO = {"x": al.Uniform.bounds(-1.0, 1.0), "z": al.Uniform.bounds(1.0, 3.0)}
ORDER = al.Expansion(order=3)


def directly(function=boxes.smooth, expansion=ORDER):
    return al.expand(function, TWO, expansion, traced=False)


def assert_same(expanded, other):
    for name, coefficients in other.coefficients.items():
        np.testing.assert_array_equal(expanded.coefficients[name], coefficients)
        np.testing.assert_array_equal(expanded.samples[name], other.samples[name])
    np.testing.assert_array_equal(expanded.collocation.points, other.collocation.points)


def spawned(workers=2):
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))


class Counted:
    """A function that counts its calls, from several threads too: in a queue, which cannot be read as its code."""

    def __init__(self, function=boxes.smooth):
        self.function, self._queue = function, queue.SimpleQueue()

    @property
    def calls(self):
        return self._queue.qsize()

    def __call__(self, at):
        self._queue.put(None)
        return self.function(at)


def until(path, failing):
    """`failing` until there is a file, and `boxes.smooth` from then on."""
    path = str(path)
    return lambda at: boxes.smooth(at) if Path(path).exists() else failing(at)


# --- The same bits ---------------------------------------------------------------------------------------------------


def test_a_box_gives_the_bits_of_its_function():
    assert_same(al.expand(al.foreign.BlackBox(boxes.smooth), TWO, ORDER), directly())


def test_threads_give_the_same_bits():
    with ThreadPoolExecutor(4) as executor:
        assert_same(al.expand(al.foreign.BlackBox(boxes.smooth, executor=executor), TWO, ORDER), directly())


def test_spawned_processes_give_the_same_bits():
    with spawned() as executor:
        box = al.foreign.BlackBox(boxes.smooth, executor=executor)
        assert_same(al.expand(box, TWO, ORDER), directly())


def test_a_system_as_a_model_gives_the_same_bits():
    def doubled(model):
        assert isinstance(model.rate, float)
        return 2.0 * model.rate

    decay = Decay(al.Normal(1.0, 0.1))
    found = al.expand(al.foreign.BlackBox(doubled), decay)
    np.testing.assert_array_equal(found.coefficients, al.expand(doubled, decay, traced=False).coefficients)


@pytest.mark.parametrize(
    "expansion",
    [
        al.Expansion(index_set=al.index_sets.Adaptive(error=1e-4)),
        al.Expansion(4, fit=al.fits.Sparse()),
        al.Expansion(3, points=al.points.GaussPoints(), fit=al.fits.Projection()),
    ],
)
def test_outputs_may_choose_terms_and_points(expansion):
    counted = Counted()
    expanded = al.expand(al.foreign.BlackBox(counted), TWO, expansion)
    assert_same(expanded, directly(expansion=expansion))
    assert counted.calls == len(expanded.collocation.points)


def test_elements_take_boxes():
    def kinked(at):
        return abs(at["x"]) + at["z"]

    wish = al.MultiElement(order=2, error=1e-2)
    found = al.expand(al.foreign.BlackBox(kinked), TWO, wish)
    np.testing.assert_array_equal(found.coefficients, al.expand(kinked, TWO, wish, traced=False).coefficients)


def test_random_samples_are_those_of_the_function():
    box = al.foreign.BlackBox(boxes.smooth)
    for method in (al.references.monte_carlo, al.references.quasi_monte_carlo):
        found = method(box, TWO, 64, seed=3).values
        plain = method(boxes.smooth, TWO, 64, seed=3, traced=False).values
        np.testing.assert_array_equal(found["v"], plain["v"])


# --- Samples that fail -----------------------------------------------------------------------------------------------


def refused(box, model=TWO, kind=al.SimulationError, expansion=ORDER):
    with pytest.raises(kind) as caught:
        al.expand(box, model, expansion)
    return str(caught.value)


def odd(value):
    """A function that returns something else at one sample."""
    return lambda at: value if at["x"] > 0.9 else boxes.smooth(at)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("fast", "received str"),
        (None, "returns nothing"),
        ({}, "no outputs"),
        ({"y": 1j, "v": np.zeros(3)}, "complex"),
        ({"y": np.nan, "v": np.zeros(3)}, "output 'y' is nan"),
        ({"y": 1.0, "v": np.array([0.0, np.inf, 0.0])}, "output 'v' is inf"),
        ({"y": 1.0}, "'y' of shape (), where sample 1 had 'v' of shape (3,), 'y' of shape ()"),
        ({"y": 1.0, "v": np.zeros(2)}, "'v' of shape (2,)"),
    ],
)
def test_nonsense_is_refused_by_sample_and_inputs(value, said):
    message = refused(al.foreign.BlackBox(odd(value)))
    assert said in message
    assert re.search(r"failed at sample 30 \(x=0\.9\d*, z=[\d.]+\)", message)
    assert "Finished samples are kept by this box (29)" in message


def test_an_exception_is_told_in_one_line():
    message = refused(al.foreign.BlackBox(boxes.stiff))
    assert "it raised ValueError: no convergence. Finished" in message
    assert "'stiff' failed at sample" in message


def test_an_input_that_there_is_not_ends_at_once_whatever_may_be_dropped():
    counted = Counted(lambda at: at["w"])
    assert "asks for the input 'w'" in refused(al.foreign.BlackBox(counted, drop=0.4, retries=3), kind=al.ProblemError)
    assert counted.calls == 1


def test_a_key_that_the_function_itself_lacks_fails_one_sample_alone():
    def looked_up(at):
        return {True: boxes.smooth(at)}[at["x"] < 0.95]

    assert "it raised KeyError: False" in refused(al.foreign.BlackBox(looked_up))
    with pytest.warns(al.SimulationWarning, match="1 of 30 samples"):
        al.expand(al.foreign.BlackBox(looked_up, drop=0.05), TWO, ORDER)


def test_a_sample_that_fails_once_is_run_again():
    seen = set()

    def moody(at):
        if at["x"] not in seen:
            seen.add(at["x"])
            raise OSError("no licence")
        return boxes.smooth(at)

    counted = Counted(moody)
    assert_same(al.expand(al.foreign.BlackBox(counted, retries=1), TWO, ORDER), directly())
    assert counted.calls == 2 * 30
    seen.clear()
    assert "OSError: no licence" in refused(al.foreign.BlackBox(moody))


@pytest.mark.parametrize("threads", [0, 4])
def test_dropped_samples_leave_least_squares_at_the_others_and_a_warning_of_the_bias(threads):
    executor = ThreadPoolExecutor(threads) if threads else None
    box = al.foreign.BlackBox(boxes.stiff, drop=0.1, executor=executor)
    with pytest.warns(al.SimulationWarning) as caught:
        expanded = al.expand(box, TWO, al.Expansion(order=4))
    message = str(caught[0].message)
    full = directly(expansion=al.Expansion(order=4))
    points = np.asarray(full.collocation.points)
    kept = ~((points[:, 0] > 0.7) & (points[:, 1] > 0.5))  # z = 2 + its germ
    missing = np.count_nonzero(~kept)
    assert message.startswith(f"{missing} of 45 samples of 'stiff' failed and were dropped")
    assert f"where {missing} of {missing} samples failed" in message
    assert "x from 0.7" in message
    assert "may be biased" in message
    # The least squares of the others, computed independently.
    np.testing.assert_array_equal(expanded.collocation.points, points[kept])
    matrix, values = np.asarray(full.collocation.matrix)[kept], np.asarray(full.samples["y"])[kept]
    np.testing.assert_allclose(expanded.coefficients["y"], np.linalg.lstsq(matrix, values)[0], rtol=1e-11, atol=1e-13)
    if executor:
        executor.shutdown()


def test_a_random_sample_without_the_corner_is_biased_as_the_warning_says():
    with pytest.warns(al.SimulationWarning, match=r"where (\d+) of \1 samples failed\. Statistics may be biased"):
        sampled = al.references.monte_carlo(al.foreign.BlackBox(boxes.stiff, drop=0.1), TWO, 400)
    # The mean over what is left of the square: without the corner x > 0.7, z > 2.5, of probability 0.15 * 0.25.
    corner = (np.e - np.exp(0.7)) / 2 * (9.0 - 2.5**2) / 4
    biased = (2 * np.sinh(1.0) - corner) / (1 - 0.15 * 0.25)
    mean = sampled["y"].mean
    assert abs(mean.value - biased) < 4 * mean.standard_error
    assert sampled.samples < 400


def test_more_failures_than_allowed_are_refused():
    message = refused(al.foreign.BlackBox(boxes.stiff, drop=0.03), expansion=al.Expansion(order=4))
    assert "2 of 45 samples failed, and drop=0.03 allows 1: 'stiff' failed at sample" in message


def test_too_large_a_hole_is_refused_by_the_condition_number():
    def narrow(at):
        if at["x"] > 0.4:
            raise ValueError("no convergence")
        return boxes.smooth(at)

    box = al.foreign.BlackBox(narrow, drop=0.4)
    with pytest.warns(al.SimulationWarning, match="may be biased"):
        message = refused(box, kind=al.ProblemError, expansion=al.Expansion(order=6))
    assert re.search(r"condition number of least squares from [\d.]+ to \d+", message)


@pytest.mark.parametrize(
    "method",
    [
        lambda box: al.expand(box, TWO, al.Expansion(index_set=al.index_sets.Adaptive(error=1e-4))),
        lambda box: al.expand(box, TWO, al.MultiElement(order=2)),
        lambda box: al.references.quasi_monte_carlo(box, TWO, 64),
    ],
)
def test_methods_that_need_every_sample_drop_none(method):
    with pytest.raises(al.SimulationError, match="needs every sample, so that none is dropped"):
        method(al.foreign.BlackBox(odd(None), drop=0.4))


def test_interpolation_needs_every_sample():
    expansion = al.Expansion(2, points=al.points.OptimalPoints(), fit=al.fits.Interpolation())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", al.SimulationWarning)
        assert "Interpolation needs all" in refused(
            al.foreign.BlackBox(boxes.stiff, drop=0.49), kind=al.ProblemError, expansion=expansion
        )


def test_statistics_of_a_box_have_no_derivatives():
    def spread(half_width):
        return al.expand(al.foreign.BlackBox(lambda at: at["x"]), {"x": al.Uniform(0.0, half_width=half_width)}).std

    with pytest.raises(al.ProblemError, match="is a black box, so nothing can be differentiated"):
        jax.grad(spread)(0.1)


def test_methods_with_derivatives_refuse_boxes():
    for method in (al.references.linearise, al.references.second_order):
        with pytest.raises(al.ProblemError, match="a black box has no derivatives"):
            method(al.foreign.BlackBox(boxes.smooth), TWO)


def test_a_function_may_change_what_it_is_given():
    def moody(at):
        first = at["x"] not in seen
        seen.add(at["x"])
        at["x"] = at["x"] + 1.0
        at["table"] += 1.0
        if first:
            raise OSError("no licence")
        return at["x"] + at["table"].sum()

    seen = set()
    model = TWO | {"table": np.zeros(2)}
    found = al.expand(al.foreign.BlackBox(moody, retries=1), model, ORDER)
    assert float(found.mean) == pytest.approx(3.0)
    assert float(found.std) == pytest.approx(1 / np.sqrt(3))


@pytest.mark.parametrize("function", [al.foreign.Command(["program", "{x}", "{z}"]), al.foreign.Isolated(boxes.smooth)])
def test_what_leaves_this_process_is_not_traced_and_says_so(function):
    with pytest.raises(al.ProblemError, match=r"wrap it, al\.foreign\.BlackBox\((Command|Isolated)"):
        al.expand(function, TWO)


# --- Journals --------------------------------------------------------------------------------------------------------


def test_a_second_call_goes_on_where_the_first_failed(tmp_path):
    counted = Counted(until(tmp_path / "repaired", odd(None)))
    box = al.foreign.BlackBox(counted)
    refused(box)
    assert counted.calls == 30
    (tmp_path / "repaired").touch()
    assert_same(al.expand(box, TWO, ORDER), directly())
    assert counted.calls == 31


def test_threads_finish_what_they_have_begun_and_nothing_is_run_twice(tmp_path):
    counted = Counted(until(tmp_path / "repaired", boxes.stiff))
    with ThreadPoolExecutor(3) as executor:
        refused(al.foreign.BlackBox(counted, executor=executor, journal=tmp_path / "runs.jsonl"))
    known = len((tmp_path / "runs.jsonl").read_text().splitlines()) - 1
    (tmp_path / "repaired").touch()
    before = counted.calls
    al.expand(al.foreign.BlackBox(counted, journal=tmp_path / "runs.jsonl"), TWO, ORDER)
    assert known + counted.calls - before == 30


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
    assert finished.stdout.split() == ["12", float(directly()["y"].mean).hex()], finished.stderr


def test_results_read_back_have_the_same_bits(tmp_path):
    first = al.expand(al.foreign.BlackBox(boxes.smooth, journal=tmp_path / "runs.jsonl"), TWO, ORDER)
    counted_lines = (tmp_path / "runs.jsonl").read_text()
    second = al.expand(al.foreign.BlackBox(boxes.smooth, journal=tmp_path / "runs.jsonl"), TWO, ORDER)
    assert_same(second, first)
    assert (tmp_path / "runs.jsonl").read_text() == counted_lines


def test_a_box_that_has_changed_is_told_and_run_again(tmp_path):
    journal = tmp_path / "runs.jsonl"
    al.expand(al.foreign.BlackBox(boxes.smooth, journal=journal), TWO, ORDER)

    def other(at):
        return {"y": 1.0 + at["x"], "v": np.zeros(3)}

    with pytest.warns(al.SimulationWarning, match="30 of these samples by another box"):
        expanded = al.expand(al.foreign.BlackBox(other, journal=journal), TWO, ORDER)
    assert_same(expanded, directly(other))


def test_a_function_that_reads_another_number_is_another_box(tmp_path):
    def with_factor(factor):
        return lambda at: factor * at["x"] + at["z"]

    for factor in (1.0, 2.0):
        box = al.foreign.BlackBox(with_factor(factor), journal=tmp_path / "runs.jsonl")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", al.SimulationWarning)
            assert float(al.expand(box, TWO).sobol("x")) == pytest.approx(factor**2 / (1 + factor**2))


@pytest.mark.parametrize("beside", [None, threading.Lock()], ids=["all is read", "a lock cannot be read"])
@pytest.mark.parametrize("kept", [False, True], ids=["in memory", "in a journal"])
def test_a_number_that_the_function_reads_may_change_between_two_calls(tmp_path, kept, beside):
    state = {"stiffness": 3.0, "beside": beside, "calls": 0}

    def spring(at):
        state["calls"] += 1
        return state["stiffness"] * at["x"]

    box = al.foreign.BlackBox(spring, journal=tmp_path / "runs.jsonl" if kept else None)
    model, expansion = {"x": al.Uniform.bounds(0.0, 1.0)}, al.Expansion(order=2)
    assert float(al.expand(box, model, expansion).mean) == pytest.approx(1.5)
    calls = state["calls"]
    assert float(al.expand(box, model, expansion).mean) == pytest.approx(1.5)
    assert state["calls"] == calls, "what the function counts itself is no change"
    state["stiffness"] = 7.0
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert float(al.expand(box, model, expansion).mean) == pytest.approx(3.5)
    assert state["calls"] == 2 * calls
    told = [str(one.message) for one in caught if issubclass(one.category, al.SimulationWarning)]
    assert len(told) == kept
    assert all("such as a count of its calls" in one for one in told)


def test_a_plain_number_of_the_model_is_part_of_a_sample(tmp_path):
    counted = Counted(lambda at: at["gain"] * at["x"])
    box = al.foreign.BlackBox(counted, journal=tmp_path / "runs.jsonl")
    spreads = [float(al.expand(box, TWO | {"gain": gain}).std) for gain in (1.0, 2.0, 1.0)]
    assert spreads[1] == pytest.approx(2 * spreads[0])
    assert counted.calls == 2 * 30


def test_a_file_that_is_no_journal_is_refused_and_left_as_it_is(tmp_path):
    table = tmp_path / "results.csv"
    table.write_text("x,y\n1,2\n")
    with pytest.raises(al.ProblemError, match="whose first line is not a journal's"):
        al.foreign.BlackBox(boxes.smooth, journal=table)
    assert table.read_text() == "x,y\n1,2\n"


def test_a_journal_that_cannot_be_written_is_refused(tmp_path):
    box = al.foreign.BlackBox(boxes.smooth, journal=tmp_path / "nowhere" / "runs.jsonl")
    assert "cannot be written" in refused(box, kind=al.ProblemError)


def test_a_journal_keeps_dicts_of_arrays_alone(tmp_path):
    box = al.foreign.BlackBox(lambda at: (at["x"], at["z"]), journal=tmp_path / "runs.jsonl")
    assert "dicts of arrays by their names" in refused(box, kind=al.ProblemError)


# --- Executors -------------------------------------------------------------------------------------------------------


def test_a_process_that_ends_breaks_its_executor_and_finished_samples_are_kept(tmp_path):
    journal = tmp_path / "runs.jsonl"
    with spawned(1) as executor:
        message = refused(al.foreign.BlackBox(boxes.crash, executor=executor, drop=0.4, journal=journal))
        assert "its executor is broken" in message
        assert "al.foreign.Isolated" in message
        known = len(journal.read_text().splitlines()) - 1
        assert known >= 1
        assert f"kept in runs.jsonl ({known})" in message
        # A broken executor is refused in the same words, when it is given again.
        assert "its executor is broken" in refused(al.foreign.BlackBox(boxes.smooth, executor=executor))


def test_what_cannot_be_sent_to_a_process_is_refused():
    with spawned(1) as executor:
        message = refused(al.foreign.BlackBox(lambda at: at["x"], executor=executor), kind=al.ProblemError)
    assert "such as a function at the top level of a module" in message


def test_an_executor_that_is_shut_down_is_refused():
    executor = ThreadPoolExecutor(1)
    executor.shutdown()
    assert "takes work" in refused(al.foreign.BlackBox(boxes.smooth, executor=executor), kind=al.ProblemError)


def test_an_executor_that_cancels_its_work_is_broken():
    class Cancelling(Executor):
        def submit(self, fn, /, *args, **kwargs):
            future = Future()
            future.cancel()
            future.set_running_or_notify_cancel()
            return future

    assert "it cancelled its work" in refused(al.foreign.BlackBox(boxes.smooth, executor=Cancelling()))


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no forks here")
def test_forked_processes_are_refused():
    with (
        ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("fork")) as executor,
        pytest.raises(al.ProblemError, match=r"whose processes are spawned.*mp_context=multiprocessing\.get_context"),
    ):
        al.foreign.BlackBox(boxes.smooth, executor=executor)


@pytest.mark.skipif(multiprocessing.get_start_method() != "fork", reason="processes are not forked by default here")
def test_forked_processes_are_refused_wherever_an_executor_is_given():
    with ProcessPoolExecutor(1) as executor:
        for method in (al.references.monte_carlo, al.references.quasi_monte_carlo):
            with pytest.raises(al.ProblemError, match=r"_carlo: executor: .*processes that are forked\. Write al\.w"):
                method(boxes.smooth, TWO, 8, executor=executor)


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
    assert counted.calls == 31


# --- Functions in processes of their own -----------------------------------------------------------------------------


def test_a_function_in_a_process_of_its_own_returns_the_same():
    at = {"x": 0.3, "z": 2.0}
    returned = al.foreign.Isolated(boxes.smooth)(at)
    np.testing.assert_array_equal(returned["v"], boxes.smooth(at)["v"])
    assert returned["y"] == boxes.smooth(at)["y"]


@pytest.mark.parametrize(
    ("function", "said"),
    [
        (al.foreign.Isolated(boxes.hanging, time_limit=0.5), "ended after its time limit of 0.5 s"),
        (al.foreign.Isolated(boxes.crash), "its process ended by itself, by exit code 3"),
    ],
)
def test_a_function_in_a_process_of_its_own_can_hang_and_crash(function, said):
    with pytest.raises(al.SimulationError, match=said):
        function({"x": 1.0, "z": 2.0})


def test_what_a_function_raises_in_a_process_of_its_own_is_told():
    with pytest.raises(al.SimulationError, match="it raised ValueError: no convergence"):
        al.foreign.Isolated(boxes.stiff)({"x": 1.0, "z": 3.0})


def test_a_function_that_only_this_process_knows_is_refused():
    message = refused(al.foreign.BlackBox(al.foreign.Isolated(lambda at: at["x"])), kind=al.ProblemError)
    assert "top level of a module" in message


# --- Command lines ---------------------------------------------------------------------------------------------------

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


def test_inputs_reach_a_command_with_all_their_digits(script):
    command = script("import json, sys; print(json.dumps([float(one) for one in sys.argv[1:]]))", "{a}", "--b={b}")
    values = {"a": 0.1 + 0.2, "b": 1.2345678901234567e-300}
    with pytest.raises(al.SimulationError, match=re.escape(f"--b={values['b']!r}")):
        command(values)
    command = script("import json, sys; print(json.dumps([float(one) for one in sys.argv[1:]]))", "{a}", "{b}")
    np.testing.assert_array_equal(command(values), list(values.values()))


def test_arrays_reach_a_command_by_its_input_file(script):
    command = script('import json; print(sum(map(sum, json.load(open("in.json"))["table"])))', input_file="in.json")
    assert command({"table": np.array([[1.0, 2.0], [3.0, 4.0]]), "name": "a text"}) == 10.0


@pytest.mark.parametrize(
    ("printed", "either"),
    [
        ('{"y": 1.5}\n0', "the last line '0' after '{\"y\": 1.5}', and either"),
        ('{"y": 1.5}\n\n  0  \n\n', "the last line '0' after '{\"y\": 1.5}', and either"),
        ('{"y": 1.5}\ndone\n0', "the last line '0' after '{\"y\": 1.5}', and either"),
        ('{\n  "y": 1.5\n}\n0', "the last line '0' after '{', and either"),
        ('{"v": [\n1.5,\n2.5', "the last line '2.5' after '{\"v\": [', and either"),
        ("{'y': 1.5}\n0", "the last line '0' after \"{'y': 1.5}\", and either"),
        ('{"y": 1.5}\n[0, 0]', "the last line '[0, 0]' after '{\"y\": 1.5}', and either"),
        ("[1.5, 2.5]\n0", "the last line '0' after '[1.5, 2.5]', and either"),
        ("[\n  1.5,\n  2.5\n]\n0", "the last line '0' after '[', and either"),
    ],
)
@pytest.mark.parametrize("output_file", [None, "out.json"])
def test_a_number_after_what_may_be_the_output_is_refused(script, printed, either, output_file):
    where = "sys.stdout" if output_file is None else f"open({output_file!r}, 'w')"
    command = script(f"import sys; print({printed!r}, file={where})", "{x}", output_file=output_file)
    with pytest.raises(al.SimulationError, match=re.escape(either)) as caught:
        command({"x": 1.0})
    assert 'Write an object, such as {"y": 1.5}, in the last line' in str(caught.value)


@pytest.mark.parametrize(
    ("printed", "output"),
    [
        ('{"progress": 0.5}\n{"progress": 1}\n{"y": 1.5}', {"y": 1.5}),
        ('[0.1, 0.2]\n0\n{"y": 1.5}\n', {"y": 1.5}),
        ("[info] begun\n[1] of [2]\n1.5", 1.5),
        ("residual\n0.5\n0.1\n1.5", 1.5),
        ("0\n[0.5, 0.1]\n[1.5, 2.5]", [1.5, 2.5]),
        ('{\n  "y": 1.5\n}\n', {"y": 1.5}),
        ("[\n  1.5,\n  2.5\n]", [1.5, 2.5]),
    ],
)
def test_what_a_program_prints_before_its_output_is_no_output(script, printed, output):
    found = script(f"print({printed!r})", "--x={x}")({"x": 1.0})
    assert jax.tree.map(np.ndarray.tolist, found) == output


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("print('all is well')", "expected JSON in its standard output; received 'all is well'"),
        ("pass", "expected JSON in its standard output; received nothing"),
        ('print(\'{"y": "fast"}\')', "the output 'y': expected numbers; received 'fast'"),
        ("print('{\"y\": [1, [2]]}')", "the output 'y': expected numbers"),
        ("print('{\"y\": null}')", "the output 'y': expected numbers; received None"),
        ("print('{\"y\": true}')", "the output 'y': expected numbers; received True"),
        ("print('NaN')", "its output is nan"),
        ("import sys; sys.exit('mesh is tangled')", "exit code 1; its stderr ends with: mesh is tangled"),
        ("import sys; sys.exit(7)", "exit code 7; its stderr is empty"),
        ("import os; os.abort()", "it ended by "),
    ],
)
def test_a_command_that_fails_is_told_by_sample_and_inputs(script, text, said):
    message = refused(al.foreign.BlackBox(script(text, "{x}", "{z}")), expansion=al.Expansion(1))
    assert said in message
    assert f"'{Path(sys.executable).name} box.py' failed at sample 1 (x=-0.888889, z=2)" in message


def test_a_missing_file_of_outputs_is_told(script):
    command = script("print(1.0)", "{x}", "{z}", output_file="out.json")
    assert "it ended without writing out.json" in refused(al.foreign.BlackBox(command))


def test_a_missing_key_is_told(script):
    text = "import json, sys; x = float(sys.argv[1]); print(json.dumps({'y': x} if x > 0 else {'y': x, 'w': x}))"
    message = refused(al.foreign.BlackBox(script(text, "{x}", "{z}")), expansion=al.Expansion(1))
    assert "it returned 'y' of shape (), where sample 1 had 'w' of shape (), 'y' of shape ()" in message


def test_a_program_that_is_not_found_ends_at_once(script):
    command = al.foreign.Command(["no-such-program", "{x}", "{z}"])
    message = refused(al.foreign.BlackBox(command, drop=0.4, retries=9), kind=al.ProblemError)
    assert message.startswith("Command: no-such-program cannot be run (")


@pytest.mark.parametrize(
    ("arguments", "options", "said"),
    [
        (["{w}", "{x}", "{z}"], {}, "asks for ['w']"),
        (["{x}"], {}, "['z'] reach"),
    ],
)
def test_inputs_that_do_not_fit_a_command_are_refused(script, arguments, options, said):
    box = al.foreign.BlackBox(script("print(1.0)", *arguments, **options), drop=0.4)
    assert said in refused(box, kind=al.ProblemError)


def test_a_changed_script_is_another_command(script, tmp_path):
    for factor in (1.0, 2.0):
        command = script(f"import sys; print({factor} * float(sys.argv[1]) + float(sys.argv[2]))", "{x}", "{z}")
        box = al.foreign.BlackBox(command, journal=tmp_path / "runs.jsonl")
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            expanded = al.expand(box, TWO, al.Expansion(1))
        assert len(caught) == (factor == 2.0)
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


WAITING = """
import time
open({begun!r}, "w").close()
time.sleep(100)
open({survived!r}, "w")
"""


@pytest.mark.skipif(os.name == "nt", reason="pipes with names are POSIX's")
def test_ctrl_c_ends_the_commands_that_threads_wait_for(script, tmp_path, python_interrupts):
    begun, survived = tmp_path / "begun", tmp_path / "survived"
    os.mkfifo(begun)
    command = script(WAITING.format(begun=str(begun), survived=str(survived)), "{x}", "{z}")

    def interrupt():
        begun.open().close()  # waits for the script
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    with ThreadPoolExecutor(1) as executor, pytest.raises(KeyboardInterrupt):
        al.expand(al.foreign.BlackBox(command, executor=executor), TWO, ORDER)
    assert not survived.exists()


def test_a_command_that_hangs_in_a_corner_is_dropped_there(script):
    text = """
        import sys, threading
        x, z = map(float, sys.argv[1:])
        if x > 0.6 and z > 2.6: threading.Event().wait()
        print(x * z)
    """
    command = script(text, "{x}", "{z}", time_limit=3.0)
    with pytest.warns(al.SimulationWarning, match="ended after its time limit of 3 s"):
        expanded = al.expand(al.foreign.BlackBox(command, drop=0.2), TWO, al.Expansion(2))
    assert float(expanded.std) == pytest.approx(np.sqrt(4 / 3 + 1 / 9), rel=1e-12)


def test_journals_are_lines_of_json(tmp_path):
    journal = tmp_path / "runs.jsonl"
    al.expand(al.foreign.BlackBox(boxes.smooth, journal=journal), TWO, ORDER)
    header, *lines = map(json.loads, journal.read_text().splitlines())
    assert header["journal"] == "aleator.foreign"
    assert [set(line) for line in lines] == [{"box", "key", "inputs", "outputs"}] * 30
    assert lines[0]["outputs"]["y"] == boxes.smooth(lines[0]["inputs"])["y"]
