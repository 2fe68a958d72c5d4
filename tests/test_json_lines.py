"""Files of JSON lines, whatever a crash left of them."""

from pathlib import Path

import pytest

from aleator._core.json_lines import read_lines


def test_whole_lines_are_read_and_a_cut_one_is_told_apart(tmp_path: Path):
    path = tmp_path / "lines.jsonl"
    path.write_bytes(b'{"a": 1}\n\nnonsense\n\xff\n[2]\n{"a": ')
    found = read_lines(path)
    assert [(one.number, one.value) for one in found.lines] == [(1, {"a": 1}), (3, None), (4, None), (5, [2])]
    assert found.cut == b'{"a": '
    assert path.read_bytes()[: found.size].endswith(b"[2]\n")


def test_a_line_without_its_end_does_not_count_however_whole_it_looks(tmp_path: Path):
    path = tmp_path / "lines.jsonl"
    path.write_bytes(b'{"a": 1}')
    assert read_lines(path).lines == ()
    assert read_lines(path).size == 0


def test_no_file_has_no_lines_and_an_unreadable_one_is_an_error(tmp_path: Path):
    assert read_lines(tmp_path / "missing") == ((), 0, b"")
    with pytest.raises(OSError):  # noqa: PT011  of whatever kind for a folder
        read_lines(tmp_path)
