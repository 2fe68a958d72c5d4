"""Work by an executor of `concurrent.futures`: in other processes, on other machines, or in threads of this process.

Arguments and results travel as pickles of our own, so that every executor gives the same, and what cannot travel is
told before anything is sent. Threads of this process are handed the objects themselves, so that any model will do.
Processes can be ended with all those that they started, and end when nobody waits for them any more.
"""

import concurrent.futures
import hashlib
import os
import pickle
import signal
import subprocess
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import connection, parent_process
from multiprocessing.connection import Connection
from typing import IO, Any, TypeAlias, TypeVar, final

from aleator._core.border import refusal, shown
from aleator._core.errors import AleatorError, AleatorWarning, ProblemError, SimulationError, warned_of

Work: TypeAlias = Callable[..., Any]
"""A function of a module of ours, so that a pickle names it."""

_Item = TypeVar("_Item")

# Calls of an executor at most for many items: enough to share them evenly, few enough that sending costs nothing.
_CALLS = 32

# As much of the end of what a process printed as a message repeats.
_SHOWN = 160

# Executors whose threads have interpreters of their own, which share no objects: since Python 3.14.
_APART: Any = getattr(concurrent.futures, "InterpreterPoolExecutor", ())

# Python hears warnings in one thread of a process at a time; several threads of one would take them from each other.
_HEARD = threading.RLock()


def check_executor(who: str, executor: Any) -> None:
    """Refuse what is no executor of `concurrent.futures`, and forked processes: the threads of JAX survive no fork."""
    if executor is None:
        return
    if not isinstance(executor, Executor):
        expected = "an executor, such as al.workers(2), loky's, or Dask's client.get_executor()"
        raise refusal(f"{who}: executor", expected, executor)
    context = getattr(executor, "_mp_context", None)  # of a ProcessPoolExecutor, also where none was given
    if context is not None and context.get_start_method() == "fork":
        raise ProblemError(
            f"{who}: executor: expected one whose processes are spawned, because forked ones can hang for ever with "
            "JAX; received processes that are forked. Write al.workers(2), or "
            'ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")).'
        )


def is_of_this_process(executor: Executor) -> bool:
    """Whether an executor works in threads of this process, which have its objects without any journey."""
    return isinstance(executor, ThreadPoolExecutor) and not isinstance(executor, _APART)


def each_done(
    executor: Executor, work: Work, calls: Mapping[int, Mapping[str, Any]], where: Sequence[str]
) -> Iterator[tuple[int, Any]]:
    """The results of `work` for some arguments, or our own exceptions, each by its number, as soon as they are there.

    All is packed before any is sent. Warnings begin with the words in `where`. Where the caller stops, what has not
    begun is cancelled. Raises `ProblemError` for arguments that cannot travel, and `SimulationError` if an executor
    takes no work, workers keep dying, or what they give is no result of their work.
    """
    packs = {i: packed(executor, work, one) for i, one in calls.items()}
    numbers: dict[Future[Any], int] = {}
    try:
        for i, pack in packs.items():
            try:
                numbers[executor.submit(run, pack)] = i
            except Exception as error:  # every executor has its own
                why = f"the executor did not take the work ({type(error).__name__}: {error})"
                raise _lost(where[i], why) from error
        for future in as_completed(numbers):
            i = numbers[future]
            yield i, _received(future, packs[i], where[i])
    finally:
        for future in numbers:
            future.cancel()


def each_of(
    executor: Executor, work: Work, items: Sequence[_Item], given: Mapping[str, Any], where: str
) -> Iterator[tuple[_Item, Any]]:
    """Each item with what is found for it, in order; `work(items=some, **given)` returns a list for some of them.

    Neighbours are sent together, the same ones to every executor. Raises the errors of `each_done`, and those of the
    work.
    """
    size = max(-(-len(items) // _CALLS), 1)
    shares = [items[first : first + size] for first in range(0, len(items), size)]
    calls = {i: {**given, "items": one} for i, one in enumerate(shares)}
    waiting: dict[int, Sequence[Any]] = {}
    following = 0
    for i, found in each_done(executor, work, calls, [where] * len(calls)):
        if isinstance(found, AleatorError):
            raise found
        waiting[i] = found
        while following in waiting:
            yield from zip(shares[following], waiting.pop(following), strict=True)
            following += 1


def _lost(where: str, why: str) -> SimulationError:
    return SimulationError(f"{where}: {why}. Finished results are kept within al.journal(folder), for the next run.")


@final
@dataclass(frozen=True)
class Pack:
    """Some work with its arguments, as an executor is given it: a pickle, or for threads of this process as it stands.

    - `name`: its own, with which it is answered, so that no result is believed that is given for another one.
    """

    content: Any = field(compare=False)
    name: Any

    @property
    def travels(self) -> bool:
        """Whether it goes to another process, and its answer comes from there."""
        return isinstance(self.content, bytes)

    def opened(self) -> tuple[Work, Mapping[str, Any]]:
        """The work and its arguments by name, where it is done."""
        return pickle.loads(self.content) if self.travels else self.content


def packed(executor: Executor, work: Work, call: Mapping[str, Any]) -> Pack:
    """Some work with its arguments by name. Raises `ProblemError` for what other processes could not read."""
    if is_of_this_process(executor):
        return Pack((work, dict(call)), object())
    remedy = "or give it to threads of this process, ThreadPoolExecutor(2), which take any model."
    try:
        content = pickle.dumps((work, dict(call)))
    except Exception as error:  # of whatever kind a user's object raises
        raise ProblemError(
            f"executor: the model cannot be sent to another process ({error}). Write its classes and functions in a "
            f"module, not inside functions; {remedy}"
        ) from error
    if b"__main__" in content:
        raise ProblemError(
            "executor: the model has classes or functions of the script itself (`__main__`), which other processes do "
            f"not have. Move them into a module, a file of their own beside the script, and import them from there; "
            f"{remedy}"
        )
    return Pack(content, hashlib.sha256(content).digest())


def run(pack: Pack) -> Any:
    """Do some work where an executor does it: the result or our own exception, and the warnings, as an answer."""
    work, call = pack.opened()
    with _HEARD, warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            result = work(**call)
        except AleatorError as error:
            result = error
    told = [(one.category, str(one.message)) for one in heard if issubclass(one.category, AleatorWarning)]
    answer = pack.name, result, told
    return pickle.dumps(answer) if pack.travels else answer


def _received(future: "Future[Any]", pack: Pack, where: str) -> Any:
    """The result of `run` for a pack, or our own exception as a result, with its warnings told here."""
    try:
        given = future.result()
    except (OSError, RuntimeError, CancelledError) as error:
        raise SimulationError(
            f"{where}: its worker died or was lost ({type(error).__name__}: {error}). Finished results are kept within "
            "al.journal(folder); is there enough memory for as many workers?"
        ) from error
    try:
        name, result, told = pickle.loads(given) if pack.travels else given
    except Exception as error:  # of whatever kind nonsense raises
        raise _lost(where, f"expected what a worker has found; received {shown(given)} from the executor") from error
    if name != pack.name:
        raise _lost(where, "the executor gave the result of other work, which is not used")
    with _HEARD, warned_of(where):
        for category, message in told:
            warnings.warn(message, category, stacklevel=2)
    return result


# The processes that threads of this one are waiting for, and how often all of them have been ended.
_RUNNING: set[int] = set()
_ended = 0


def in_group() -> dict[str, Any]:
    """What `subprocess.Popen` needs so that a process and its children form a group."""
    return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP} if os.name == "nt" else {"start_new_session": True}


def end_group(process: int) -> None:
    """End a process that leads a group and has not been waited for, with its children."""
    if os.name == "nt":
        subprocess.run(["taskkill", "/T", "/F", "/PID", str(process)], capture_output=True, check=False)
        return
    try:
        os.killpg(process, signal.SIGKILL)
    except ProcessLookupError:
        return


def endings() -> int:
    """How often `end_running` has been called: to be asked before a process is started."""
    return _ended


@contextmanager
def ended_with(process: int, is_over: Callable[[], bool], before: int) -> Iterator[None]:
    """End a process that leads a group if the block is left before it `is_over`, or if `end_running` is called.

    `before`: the `endings` before it was started; one that was called since then did not know of it.
    """
    _RUNNING.add(process)
    if endings() != before:
        end_group(process)
    try:
        yield
    finally:
        _RUNNING.discard(process)
        if not is_over():
            end_group(process)


def end_running() -> None:
    """End all processes that threads of this one are waiting for: an interrupt reaches neither of them."""
    global _ended
    _ended += 1
    for process in list(_RUNNING):
        end_group(process)


def exit_told(code: int | None) -> str:
    """How a process ended, in words: by a signal, whose number is negative, or with an exit code."""
    if code is None or code >= 0:
        return f"exit code {code}"
    try:
        return f"the signal {signal.Signals(-code).name}"
    except ValueError:
        return f"the signal {-code}"


def last_lines(printed: IO[bytes]) -> str:
    """The end of what a process printed into a file, in one line; empty if there is nothing."""
    printed.seek(max(0, printed.seek(0, os.SEEK_END) - 10 * _SHOWN))
    lines = [" ".join(line.split()) for line in printed.read().decode(errors="replace").splitlines() if line.strip()]
    return " / ".join(lines[-3:])[-_SHOWN:].rstrip(".")


def end_with_parent(end: Callable[[], None] = end_running) -> None:
    """In a process that `multiprocessing` has begun: end as soon as the one that began it is gone, however that ended.

    Without this it waits for work, or works for nobody, for ever after a `kill -9` there. `end` comes before.
    """
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        connection.wait([parent.sentinel])
        try:
            end()
        finally:
            os._exit(1)  # from a thread: the main one may be within a library

    threading.Thread(target=watch, name="end with parent", daemon=True).start()


def report(sender: Connection, function: Callable[[Any], Any], argument: Any) -> None:
    """In a process of its own: call a function and send what it returns, or what it raises as text."""
    if os.name != "nt":
        os.setsid()
    end_with_parent(lambda: end_group(os.getpid()))
    try:
        sender.send((function(argument), None))
    except Exception as error:
        sender.send((None, f"{type(error).__name__}: {error}"))
