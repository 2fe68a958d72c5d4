"""What is found once for each object: told by identity, forgotten with the object."""

import gc
import weakref

from aleator._core.once import once_for_each


class Thing:
    def __init__(self, size):
        self.size = size

    def __eq__(self, other):
        return True

    def __hash__(self):
        return 0


def test_an_object_is_asked_once_and_an_equal_one_by_itself():
    asked = []
    found = once_for_each(lambda thing: asked.append(thing.size) or thing.size)
    one, other = Thing(1), Thing(2)
    assert [found(one), found(other), found(one), found(other)] == [1, 2, 1, 2]
    assert asked == [1, 2]


def test_objects_are_not_kept_alive_and_addresses_that_are_used_again_say_nothing():
    found = once_for_each(lambda thing: thing.size)
    thing = Thing(0)
    found(thing)
    gone = weakref.ref(thing)
    del thing
    gc.collect()
    assert gone() is None
    assert [found(Thing(size)) for size in range(100)] == list(range(100))
