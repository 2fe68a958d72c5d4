"""Work of one's own within a journal: done once for the same code and numbers; and lines of JSON after a crash."""

import collections
import dataclasses
import enum
import functools
import itertools
import signal
import threading
import types
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
import scipy

import aleator as al
from aleator._core import journalled as journal_hook
from aleator._core.identity import identity_of
from aleator._core.journalled import NotKeptError, journalled, read_lines
from aleator.extending import kept
from aleator.journalling import recalling
from aleator.journalling._results import Parts
from executors import AsProcesses, scattered
from zoo import bar_problem, gain_problem

STEP = 1.0


def widths(least: float, count: int, progress) -> list[float]:
    """A list, as a plain result; each call is reported."""
    progress("widths", 0, 1)
    return [least + STEP * i for i in range(count)]


def test_two_functions_of_one_line_are_two():
    assert len({identity_of(one) for one in (lambda x: x, lambda x: x, lambda x: 2 * x, lambda x: 3 * x)}) == 3


LOCK = threading.Lock()


def drawn(count: int, progress) -> float:
    with LOCK:
        pass
    progress("draws", 0, 1)
    return float(np.random.default_rng(0).normal(size=count).mean())


def solved(problem: al.Problem) -> tuple[float, al.Solution]:
    found = al.solve(problem)
    return found.objective, found


def unreadable(count: int):
    return lambda: count


def scaled(factor: float, number: float) -> float:
    return factor * number


@pytest.fixture
def calls() -> list[str]:
    return []


@pytest.fixture
def work(tmp_path: Path, calls: list[str]):
    """Some work in the journal of a folder, as each run of a script begins it; each call of its function is noted."""

    def run(*arguments, name="widths", function=widths, **named):
        def note(task: str, done: int, total: int) -> None:
            calls.append(task)

        with al.journal(tmp_path):
            return kept(name, function, *arguments, progress=note, **named)

    return run


class Material(enum.Enum):
    PART = 210.0


class Softer(enum.Enum):
    PART = 70.0


Softer.__qualname__ = Material.__qualname__  # as after an edit


class Kilograms(float):
    """A number with a name."""


@dataclasses.dataclass
class Table:
    """A table that does not take part in comparisons."""

    rows: np.ndarray = dataclasses.field(compare=False)


class Slots:
    """An object without a dict, and a number in a slot of a class and of its base."""

    __slots__ = ("number",)

    def __init__(self, number: float):
        self.number = number


class OfSlots(Slots):
    __slots__ = ()


SPLINES = [scipy.interpolate.CubicSpline([0.0, 1.0, 2.0], [0.0, end, 2.0]) for end in (1.0, 1.5)]


@pytest.mark.parametrize(
    "pair",
    [
        SPLINES,
        [Material.PART, Softer.PART],
        [Kilograms(1.0), Kilograms(2.0)],
        [Table(np.zeros(2)), Table(np.ones(2))],
        [OfSlots(1.0), OfSlots(2.0)],
        [collections.defaultdict(int), collections.defaultdict(list)],
        [np.frompyfunc(lambda x: x, 1, 1), np.frompyfunc(lambda x: 2 * x, 1, 1)],
        [types.MethodType(lambda _, x: x, 3), types.MethodType(lambda _, x: 2 * x, 3)],
    ],
)
def test_objects_that_differ_in_anything_are_told_apart(pair):
    one, other = map(identity_of, pair)
    assert one is None or one != other


def test_work_is_done_once_for_the_same_code_and_numbers_however_they_are_given(work, calls, tmp_path):
    assert work(1.0, 3) == work(1.0, 3) == work(least=1.0, count=3) == [1.0, 2.0, 3.0]
    assert calls == ["widths"]
    (entry,) = al.load(tmp_path).entries
    assert (entry.what, entry.name, entry.state) == ("work widths", "", "done")
    assert al.load(tmp_path)["work widths 1"] == [1.0, 2.0, 3.0]
    with recalling(tmp_path) as folder:
        assert kept("widths", widths, 1.0, 3, progress=lambda *told: calls.append("again")) == [1.0, 2.0, 3.0]
        with pytest.raises(NotKeptError):
            kept("widths", widths, 1.0, 4, progress=lambda *told: calls.append("again"))
    assert folder.missing == ["work widths is missing."]
    assert calls == ["widths"]


def test_work_may_be_a_partial_function(tmp_path):
    for _ in range(2):
        with al.journal(tmp_path):
            assert kept("doubled", functools.partial(scaled, 2.0), 3.0) == 6.0


def test_work_on_a_dict_in_another_order_is_other_work(tmp_path):
    for parts in ({"shaft": 10.0, "ring": 3.0}, {"ring": 3.0, "shaft": 10.0}):
        with al.journal(tmp_path):
            assert kept("order", list, parts) == list(parts)


def test_code_that_changed_is_told_and_the_work_done_again(work, calls, monkeypatch):
    work(1.0, 2)
    monkeypatch.setattr(f"{__name__}.STEP", 0.5)
    with pytest.warns(al.JournalWarning, match="the model's code has changed since"):
        assert work(1.0, 2) == [1.0, 1.5]
    assert len(calls) == 2


def test_what_another_run_could_not_recognise_or_read_is_not_kept_and_said(work, calls, tmp_path):
    for _ in range(2):
        with pytest.warns(
            al.JournalWarning, match="work mean is not kept: .*'LOCK', which .*drawn names, cannot be written out"
        ):
            assert work(4, name="mean", function=drawn) == pytest.approx(np.random.default_rng(0).normal(size=4).mean())
    assert len(calls) == 2
    with al.journal(tmp_path), pytest.warns(al.JournalWarning, match="no other process could read"):
        assert kept("a function", unreadable, 3)() == 3
    assert not list((tmp_path / "finished").iterdir())


def swallowing(number: int) -> int:
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        return number
    return -number


def test_what_ctrl_c_ended_early_is_done_again_and_what_is_finished_is_not(tmp_path, python_interrupts):
    with al.journal(tmp_path), pytest.raises(KeyboardInterrupt):
        kept("numbers", swallowing, 3)
    assert [one.state for one in al.load(tmp_path).entries] == ["interrupted"]
    ended = [True, False]
    for interrupted in (True, False, False):  # the third is recalled
        with al.journal(tmp_path):
            found = journalled("work", {"number": 1}, lambda: SimpleNamespace(interrupted=ended.pop(0)))
        assert found.interrupted == interrupted


def test_designs_found_by_kept_work_are_parts_of_its_result(tmp_path):
    found = []
    for _ in range(2):
        with al.journal(tmp_path):
            found.append(kept("the lightest", solved, bar_problem()))
    (first, design), (again, recalled) = found
    assert first == again == recalled.objective
    assert design.vector.tobytes() == recalled.vector.tobytes()
    assert [one.what for one in al.load(tmp_path).entries] == ["work the lightest"]


# --- What was ended goes on ------------------------------------------------------------------------------------------

MODEL = {"off": al.Uniform(0.0, half_width=1.0), "more": al.Normal(2.0, 0.1)}


@functools.cache
def solution() -> al.Solution:
    return al.solve(gain_problem())


def by_executor(**how):
    with AsProcesses(2) as executor:
        return al.references.quasi_monte_carlo(scattered, MODEL, 2048, batch=100, executor=executor, **how)


ENDED = {
    "a sample": lambda **how: al.references.monte_carlo(scattered, MODEL, 2048, batch=100, **how).values,
    "a net by an executor": lambda **how: by_executor(**how).values,
    "evidence": lambda **how: [
        (one.mean, one.std, one.std_error)
        for one in al.validate(solution(), 3000, batch=100, **how).functionals.values()
    ],
    "a rare violation": lambda **how: dataclasses.astuple(al.rare_violation(solution(), samples=4000, seed=3, **how)),
}


@pytest.mark.parametrize("work", ENDED.values(), ids=ENDED)
def test_what_was_ended_goes_on_from_its_parts_with_the_same_digits(work, tmp_path, monkeypatch):
    def end(task: str, done: int, total: int) -> None:
        if done >= 0.5 * total:
            raise KeyboardInterrupt

    def digits(numbers) -> list[bytes]:
        return [np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(numbers)]

    parts, add = [], journal_hook._Keeping.add
    monkeypatch.setattr(journal_hook, "_OFTEN", 0.0)
    monkeypatch.setattr(journal_hook._Keeping, "add", lambda self, result: parts.append(result) or add(self, result))
    solution()
    with al.journal(tmp_path / "undisturbed"):
        undisturbed, whole = digits(work()), len(parts)
    folder = tmp_path / "ended"
    with al.journal(folder), pytest.raises(KeyboardInterrupt):
        work(progress=end)
    assert list((folder / "finished").glob("*.part"))
    assert whole < len(parts) < 2 * whole
    for recalled in (0, 1):
        with al.journal(folder) as kept_here:
            assert digits(work()) == undisturbed
        assert len(kept_here.taken) == recalled
        assert len(parts) == 2 * whole
        assert not list((folder / "finished").glob("*.part"))


# --- Parts and lines -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("way", ["part by part", "call by call"])
def test_a_run_that_is_ended_twice_goes_on_from_its_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: str):
    monkeypatch.setattr(journal_hook, "_OFTEN", 0.0)
    parts, worked, items = Parts(tmp_path, "key", pytest.fail), [], list(range(7))

    def square(item: int) -> int:
        worked.append(item)
        return item**2

    def results():
        if way == "call by call":
            return map(journal_hook.call_by_call(square, parts), items)
        squares = journal_hook.part_by_part(items, lambda some: ((one, square(one)) for one in some), parts)
        return (found for _, found in squares)

    for ended in (2, 3, 5, 7):
        assert list(itertools.islice(results(), ended)) == [one**2 for one in items[:ended]]
    assert worked == items


def test_parts_whose_places_were_exchanged_or_that_were_cut_are_not_taken(tmp_path: Path):
    parts = Parts(tmp_path, "key", pytest.fail)
    parts.keep(0, "first")
    parts.keep(1, "second")
    assert [parts.recall(number) for number in (0, 1)] == ["first", "second"]
    parts.keep(2, "cut")
    files = [tmp_path / "finished" / f"key-{number}.part" for number in range(3)]
    files[2].write_bytes(files[2].read_bytes()[:-1])
    assert parts.recall(2) is None
    files[0].replace(files[1])
    assert parts.recall(1) is None


def test_whole_lines_are_read_and_a_cut_line_is_told_apart_however_whole_it_looks(tmp_path: Path):
    path = tmp_path / "lines.jsonl"
    path.write_bytes(b'{"a": 1}\n\nnonsense\n\xff\n[2]\n{"a": ')
    found = read_lines(path)
    assert [(line.number, line.value) for line in found.lines] == [(1, {"a": 1}), (3, None), (4, None), (5, [2])]
    assert found.cut == b'{"a": '
    assert path.read_bytes()[: found.size].endswith(b"[2]\n")
    path.write_bytes(b'{"a": 1}')
    assert read_lines(path).lines == ()
    assert read_lines(tmp_path / "missing") == ((), 0, b"")
