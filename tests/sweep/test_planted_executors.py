"""What workers find belongs to the work that was sent, in whatever order they finish."""

import threading
from concurrent.futures import Future, ThreadPoolExecutor

from aleator._core.elsewhere import each_of


class Backwards(ThreadPoolExecutor):
    """An executor of this process whose work ends in the reverse order, once all of it has been sent."""

    def __init__(self, count: int):
        super().__init__(1)
        self._count, self._sent = count, []

    def submit(self, fn, /, *args, **kwargs) -> Future:
        self._sent.append((Future(), fn, args))
        if len(self._sent) == self._count:
            threading.Thread(target=self._end).start()
        return self._sent[-1][0]

    def _end(self) -> None:
        for future, fn, args in reversed(self._sent):
            future.set_result(fn(*args))


def squares(items, offset):
    return [one**2 + offset for one in items]


def test_results_are_those_of_their_items_in_order_though_the_last_ends_first():
    items = list(range(20))
    with Backwards(len(items)) as executor:
        found = list(each_of(executor, squares, items, {"offset": 3}, "a test"))
    assert found == [(one, one**2 + 3) for one in items]
