"""Runs of the command that send themselves a signal at a chosen moment, each in a process of its own.

`python rehearsed_runs.py FOLDER MOMENT:SIGNAL ...` imports the package once, forks for each run, and prints as JSON
what became of them. Nothing that JAX computes may come before a fork.
"""

import hashlib
import json
import os
import signal
import sys
import tempfile
import time
import types
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import aleator_command
from aleator import cli, studies  # noqa: F401  the commands are imported before a fork
from aleator._core import interruption
from aleator._core.progress import Progress
from aleator.reporting import PAGE, Section, Table, Verdict
from aleator.reporting._files import write_text, write_together
from aleator.studies import AbstractStudy, Stage

STAGES = ("first", "second", "third")


class Rehearsal(AbstractStudy):
    """A study of three stages that has a signal sent when it comes to the moment."""

    def __init__(self, moment: str, number: int):
        self.moment, self.number = moment, number

    @property
    def stages(self) -> Mapping[str, Stage]:
        return {name: Stage(partial(self.work, name), 1.0) for name in STAGES}

    def at(self, moment: str) -> None:
        if self.moment == moment:
            os.kill(os.getpid(), self.number)

    def work(self, stage: str, progress: Progress) -> None:
        progress("inside", 0, 2)
        self.at(f"in the {stage} stage")
        if stage == "second":
            self.second()

    def second(self) -> None:
        if self.moment == "in a callback of JAX":
            called_by_jax(lambda: self.at(self.moment))
        elif self.moment == "in a library that does not listen":
            self.at_last()
            hashlib.pbkdf2_hmac("sha512", b"", b"", 1_000_000_000)
        elif self.moment == "in work that swallows exceptions":
            forever(lambda: self.at(self.moment))
        elif self.moment == "in a destructor":
            Dying(self)
            forever(lambda: None)
        elif self.moment == "twice":
            interruption._ONE_WISH, interruption._PATIENCE = 0.1, 1e3
            forever(lambda: (time.sleep(0.3), self.at(self.moment)))

    def at_last(self) -> None:
        """Have the signal sent while this process is busy."""
        os.posix_spawn("/bin/sh", ["sh", "-c", f"sleep 0.2; kill -{self.number} {os.getpid()}"], os.environ)

    def save(self, folder: Path) -> list[Path]:
        text = " ".join(self.finished).encode()
        paths = write_together(folder, {"results.nc": text, "designs.json": text, PAGE: None})
        self.at("while a stage is saved")
        return list(paths)

    def write_page(self, folder: Path) -> Path:
        self.at("while the page is written")
        return write_text(folder / PAGE, " ".join(self.finished))

    def tables(self) -> list[Table]:
        if len(self.finished) == len(STAGES):
            self.at("while the tables are printed")
        return [Table("Stages", ["stage"], [[stage] for stage in self.finished])] if self.finished else []

    def results(self) -> Mapping[str, object]:
        return {}

    def sections(self) -> Sequence[Section]:
        return []

    def verdict(self) -> Verdict:
        self.at("at the last word")
        return Verdict("good", "Done", "to its end.")


class Dying:
    """Sends the signal when nobody needs it any more, where an exception cannot be passed on."""

    def __init__(self, study: Rehearsal):
        self.study = study

    def __del__(self) -> None:
        self.study.at(self.study.moment)


def forever(do: Callable[[], object]) -> None:
    while True:
        try:
            do()
            while True:
                time.sleep(0.2)
        except KeyboardInterrupt:
            continue


def called_by_jax(callback) -> None:
    import jax
    import jax.numpy as jnp

    def host(x):
        callback()
        return x

    jax.jit(lambda x: jax.pure_callback(host, jax.ShapeDtypeStruct((), float), x))(jnp.asarray(1.0)).block_until_ready()


def rehearse(moment: str, number: int, folder: Path) -> None:
    """One run, as the command begins it."""
    study = Rehearsal(moment, number)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    interruption._PATIENCE = 0.5

    def load(name: str, *, quick: bool) -> AbstractStudy:
        study.at("while the study is loaded")
        return study

    studies.load = load
    if moment == "while the package is imported":
        sys.modules["aleator.cli"] = types.SimpleNamespace(main=lambda: study.at(moment))
    sys.argv = ["aleator", "run", "rehearsal", "--out", str(folder)]
    aleator_command.main()


def forked(moment: str, number: int, folder: Path) -> dict:
    """What becomes of a run: its exit code (negative: killed by a signal) and what it prints."""
    with tempfile.TemporaryFile() as heard:
        child = os.fork()
        if child == 0:
            os.dup2(heard.fileno(), 1)
            os.dup2(heard.fileno(), 2)
            try:
                rehearse(moment, number, folder)
            except SystemExit as ended:
                sys.stdout.flush()
                os._exit(ended.code or 0)
            os._exit(99)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        heard.seek(0)
        return {"status": status, "output": heard.read().decode()}


if __name__ == "__main__":
    found = {}
    for wanted in sys.argv[2:]:
        moment, number = wanted.split(":")
        found[wanted] = forked(moment, int(number), Path(sys.argv[1]) / wanted)
    print(json.dumps(found))
