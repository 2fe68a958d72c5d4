"""A folder stays locked until the outermost of its writers has ended."""

from pathlib import Path

from aleator.reporting._lock import has_writer, only_writer


def test_a_writer_within_a_writer_leaves_the_folder_locked(tmp_path: Path):
    with only_writer(tmp_path):
        with only_writer(tmp_path):
            assert has_writer(tmp_path)
        assert has_writer(tmp_path)
    assert not has_writer(tmp_path)
