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
from collections.abc import Callable
from functools import partial, partialmethod
from pathlib import Path

import aleator
import aleator_command
from aleator import cli, studies  # noqa: F401  the commands are imported before a fork
from aleator.cli import _interruption as interruption
from aleator.reporting import Table, Verdict
from aleator.studies import AbstractStudy, Draft

STAGES = ("first", "second", "third")


class Rehearsal(AbstractStudy):
    """A study of three sections without work, which passes its moments to a function as it comes to them."""

    def __init__(self, at: Callable[[str], object] = lambda moment: None):
        self.at = at
        self.begun = list[str]()

    def chapter(self, page: Draft) -> None:
        for stage in STAGES:
            self.begun.append(stage)
            page.section(stage)
            page.progress("inside", 0, 2)
            self.at(f"in the {stage} stage")
            page.add(f"{stage} is done", Table(stage, ["stage"], [[stage]]), printed=True)
        page.recommend(Verdict("good", "Done", "as far as it went."))


def watch_the_end(at: Callable[[str], object]) -> None:
    """Come to the moments after the chapter as well."""
    for owner, name, moment in (
        (Draft, "save", "while results are saved"),
        (Draft, "headline", "at the last word"),
    ):
        setattr(owner, name, partialmethod(_then, getattr(owner, name), partial(at, moment)))


def _then(self: object, method: Callable[..., object], at: Callable[[], object], *arguments: object) -> object:
    at()
    return method(self, *arguments)


def second_stage(moment: str, send: Callable[[], object], number: int) -> None:
    """Work that is interrupted in the middle of something."""
    if moment == "in a callback of JAX":
        called_by_jax(send)
    elif moment == "in a library that does not listen":
        os.posix_spawn("/bin/sh", ["sh", "-c", f"sleep 0.2; kill -{number} {os.getpid()}"], os.environ)
        hashlib.pbkdf2_hmac("sha512", b"", b"", 1_000_000_000)
    elif moment == "in work that swallows exceptions":
        forever(send)
    elif moment == "twice":
        interruption._ONE_WISH, interruption._PATIENCE = 0.1, 1e3
        forever(lambda: (time.sleep(0.3), send()))


def forever(do: Callable[[], object]) -> None:
    while True:
        try:
            do()
            while True:
                time.sleep(0.2)
        except KeyboardInterrupt:
            continue


def called_by_jax(callback: Callable[[], object]) -> None:
    import jax
    import jax.numpy as jnp

    def host(x):
        callback()
        return x

    jax.jit(lambda x: jax.pure_callback(host, jax.ShapeDtypeStruct((), float), x))(jnp.asarray(1.0)).block_until_ready()


def rehearse(moment: str, number: int, folder: Path) -> None:
    """One run, as the command begins it."""
    send = partial(os.kill, os.getpid(), number)

    def at(come_to: str) -> None:
        if come_to == moment:
            send()
        elif come_to == "in the second stage":
            second_stage(moment, send, number)

    def load(name: str, *, quick: bool) -> AbstractStudy:
        at("while the study is loaded")
        return Rehearsal(at)

    signal.signal(signal.SIGINT, signal.default_int_handler)
    interruption._PATIENCE = 0.5
    studies.load = load
    watch_the_end(at)
    if moment == "while the package is imported":
        aleator.cli = types.SimpleNamespace(execute=lambda *arguments, **named: send())
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
