"""What the page on FMUs shows runs as it stands, with the FMU of these tests."""

import shutil
from pathlib import Path

import pytest

from test_documents import code_of


@pytest.mark.slow
def test_the_page_on_fmus_runs(rods, tmp_path, monkeypatch, capsys):
    shutil.copy(rods(3), tmp_path / "pendulum.fmu")
    monkeypatch.chdir(tmp_path)
    # A class in it looks its globals up, as in a script.
    script = tmp_path / "shown.py"
    script.write_text(code_of("docs/fmu.md"))
    exec(compile(script.read_text(), str(script), "exec"), {"__name__": "shown"})
    assert "status       solved" in capsys.readouterr().out
    assert Path.cwd() == tmp_path
