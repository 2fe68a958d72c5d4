"""Work of one's own within a journal: done once for the same code and numbers; and lines of JSON after a crash."""

import signal
from pathlib import Path

import numpy as np
import pytest

import aleator as al
from aleator._core.journalled import NotKeptError
from aleator._core.json_lines import read_lines
from aleator.extending import kept
from aleator.journalling import recalling
from zoo import bar_problem

STEP = 1.0


def widths(least: float, count: int, progress) -> list[float]:
    """A list, as a plain result; each call is reported."""
    progress("widths", 0, 1)
    return [least + STEP * i for i in range(count)]


def other_widths(least: float, count: int, progress) -> list[float]:
    progress("widths", 0, 1)
    return [least - STEP * i for i in range(count)]


def drawn(count: int, progress) -> float:
    progress("draws", 0, 1)
    return float(np.random.default_rng(0).normal(size=count).mean())


def solved(problem: al.Problem) -> tuple[float, al.Solution]:
    found = al.solve(problem)
    return found.objective, found


def unreadable(count: int):
    return lambda: count


class Search:
    """What was found before Ctrl-C."""

    interrupted = True


def search(count: int) -> Search:
    return Search()


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


def test_work_is_done_once_for_the_same_code_and_numbers_however_they_are_given(work, calls, tmp_path):
    assert work(1.0, 3) == work(1.0, 3) == work(least=1.0, count=3) == [1.0, 2.0, 3.0]
    assert calls == ["widths"]
    for number in (2, 3):  # without a journal, each time
        kept("widths", widths, 1.0, 2, progress=lambda task, done, total: calls.append(task))
        assert len(calls) == number
    (entry,) = al.load(tmp_path).entries
    assert (entry.what, entry.name, entry.state.value) == ("work widths", "", "done")
    assert al.load(tmp_path)["work widths 1"] == [1.0, 2.0, 3.0]


def test_other_numbers_names_and_functions_are_other_work(work, calls):
    assert work(1.0, 2) == [1.0, 2.0]
    assert work(1.5, 2) == [1.5, 2.5]
    assert work(1.0, 2, name="again") == [1.0, 2.0]
    assert work(1.0, 2, function=other_widths) == [1.0, 0.0]
    assert len(calls) == 4


def test_code_that_changed_is_told_and_the_work_done_again(work, calls, monkeypatch):
    work(1.0, 2)
    monkeypatch.setattr(f"{__name__}.STEP", 0.5)
    with pytest.warns(al.JournalWarning, match="the model's code has changed since"):
        assert work(1.0, 2) == [1.0, 1.5]
    monkeypatch.setattr(widths, "__code__", other_widths.__code__)
    with pytest.warns(al.JournalWarning, match="the model's code has changed since"):
        assert work(1.0, 2) == [1.0, 0.5]
    assert len(calls) == 3


def test_work_that_another_run_could_not_recognise_is_done_each_time_and_said(work, calls):
    for _ in range(2):
        with pytest.warns(al.JournalWarning, match="work mean is not kept: .*np.random.* that drawn reads"):
            assert work(4, name="mean", function=drawn) == pytest.approx(np.random.default_rng(0).normal(size=4).mean())
    assert len(calls) == 2


def test_what_no_other_process_could_read_is_returned_and_not_kept(tmp_path):
    with al.journal(tmp_path), pytest.warns(al.JournalWarning, match="no other process could read"):
        assert kept("a function", unreadable, 3)() == 3
    assert not list((tmp_path / "finished").iterdir())


def test_what_was_ended_early_is_continued_and_not_taken_for_the_whole(tmp_path):
    with al.journal(tmp_path):
        assert kept("search", search, 3).interrupted
    (entry,) = al.load(tmp_path).entries
    assert entry.state.value == "interrupted"
    assert not entry.is_finished


def swallowing(number: int) -> int:
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        return number
    return -number


def test_work_in_which_ctrl_c_was_pressed_is_not_kept_whatever_it_returns(tmp_path, python_interrupts):
    with al.journal(tmp_path), pytest.raises(KeyboardInterrupt):
        kept("numbers", swallowing, 3)
    assert [one.state.value for one in al.load(tmp_path).entries] == ["interrupted"]


def test_designs_found_by_kept_work_are_parts_of_its_result(tmp_path):
    found = []
    for _ in range(2):
        with al.journal(tmp_path):
            found.append(kept("the lightest", solved, bar_problem()))
    (first, design), (again, recalled) = found
    assert first == again == recalled.objective
    assert design.vector.tobytes() == recalled.vector.tobytes()
    assert [one.what for one in al.load(tmp_path).entries] == ["work the lightest"]


def squared(model):
    return model["width"] ** 2


def test_a_verb_that_no_journal_keeps_by_itself_is_kept_by_name(tmp_path):
    """The mean of a square is one third of a uniform width's square."""
    found = []
    for _ in range(2):
        with al.journal(tmp_path) as journal:
            found.append(kept("expansion", al.expand, squared, {"width": al.Uniform.bounds(0.0, 1.0)}))
    assert journal.recalled == 1
    for expanded in found:
        assert float(expanded.mean) == pytest.approx(1 / 3, rel=1e-12)
        assert float(expanded.std) == pytest.approx(np.sqrt(1 / 5 - 1 / 9), rel=1e-12)
    assert float(found[0].mean) == float(found[1].mean)


def test_a_page_of_what_is_there_does_no_work(work, calls, tmp_path):
    found = work(1.0, 2)
    with recalling(tmp_path) as folder:
        assert kept("widths", widths, 1.0, 2, progress=lambda *told: calls.append("again")) == found
        with pytest.raises(NotKeptError):
            kept("widths", widths, 1.0, 3, progress=lambda *told: calls.append("again"))
    assert folder.missing == ["work widths is missing."]
    assert calls == ["widths"]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("", widths), "kept: the name: expected a name; received ''"),
        (("bars", np.sin), "kept: the function: expected a function that takes all it works with as arguments"),
        (
            ("bars", widths, 1.0),
            "kept: expected the arguments of widths; received others: missing a required argument: 'count'",
        ),
        (("bars", lambda count: None, 1), "kept: 'bars': expected .* that returns what is kept"),
    ],
)
def test_what_cannot_be_kept_work_is_refused(arguments, told):
    with pytest.raises(al.ProblemError, match=told):
        kept(*arguments)


def test_whole_lines_are_read_and_a_cut_line_is_told_apart_however_whole_it_looks(tmp_path: Path):
    path = tmp_path / "lines.jsonl"
    path.write_bytes(b'{"a": 1}\n\nnonsense\n\xff\n[2]\n{"a": ')
    found = read_lines(path)
    assert [(line.number, line.value) for line in found.lines] == [(1, {"a": 1}), (3, None), (4, None), (5, [2])]
    assert found.cut == b'{"a": '
    assert path.read_bytes()[: found.size].endswith(b"[2]\n")
    path.write_bytes(b'{"a": 1}')
    assert read_lines(path).lines == ()
    assert read_lines(path).size == 0
    assert read_lines(tmp_path / "missing") == ((), 0, b"")
    with pytest.raises(OSError):  # noqa: PT011  of whatever kind for a folder
        read_lines(tmp_path)
