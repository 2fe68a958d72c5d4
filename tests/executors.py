"""Executors for tests."""

from concurrent.futures import Executor, Future, ThreadPoolExecutor


class AsProcesses(Executor):
    """Threads that are taken for other processes, because nobody knows them: what they are given travels as pickles."""

    def __init__(self, count: int):
        self._threads = ThreadPoolExecutor(count)

    def submit(self, fn, /, *args, **kwargs) -> Future:
        return self._threads.submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
