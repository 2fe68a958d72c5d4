"""The devices of JAX, among which the parts of a computation are shared: each part as a whole, on one device in turn.

A part's numbers therefore come from the same program whichever device computes it, and sums over parts are formed in
their order on one device. Threads drive the devices, so that at most `al.threads` of them work at once.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator
from contextvars import ContextVar
from typing import Any, NamedTuple, TypeAlias, TypeVar

import jax
from jax.core import Tracer

from aleator._core.beside import in_order

Device: TypeAlias = Any
"""A device of JAX. (A type checker cannot follow `jax.Device`.)"""

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class _Place(NamedTuple):
    """Where a part is computed, and where all that is no part is."""

    here: Device
    home: Device


_PLACE: ContextVar[_Place | None] = ContextVar("place", default=None)


def devices() -> tuple[Device, ...]:
    """The devices of this process that share the work, the one for all else first.

    One alone where JAX is told which to use (`jax.default_device`).
    """
    told = jax.config.jax_default_device  # type: ignore[attr-defined]
    if told is None:
        return tuple(jax.local_devices())
    return (jax.local_devices(backend=told)[0] if isinstance(told, str) else told,)


def home() -> Device:
    """The device for all that is no part, also when asked for within a part."""
    place = _PLACE.get()
    return devices()[0] if place is None else place.home


def here() -> Device:
    """The device of the present part, or `home`."""
    return elsewhere() or home()


def elsewhere() -> Device | None:
    """The device of the present part; None at `home`."""
    place = _PLACE.get()
    return None if place is None or place.here == place.home else place.here


def placed(tree: Any) -> Device | None:
    """The device on which a user has put an array of a tree, where all that follows from it stays; None if nowhere."""
    for leaf in jax.tree.leaves(tree):
        if isinstance(leaf, jax.Array) and not isinstance(leaf, Tracer) and leaf.committed:
            return min(leaf.devices(), key=lambda one: one.id)
    return None


def over_devices(work: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result]:
    """The results of `in_order`, where the executables called for an item run on a device of its own, in turn."""
    all_of_them = devices()
    # Threads take the first one by themselves; what JAX is told in one of them, the others do not hear.
    if [*all_of_them] == jax.local_devices()[:1]:
        return in_order(work, items)

    def at_place(given: tuple[Device, _Item]) -> _Result:
        here, item = given
        before = _PLACE.set(_Place(here, all_of_them[0]))
        try:
            # What is computed beside executables, and what arrays are made for them, belongs there too.
            with jax.default_device(here):
                return work(item)
        finally:
            _PLACE.reset(before)

    return in_order(at_place, zip(itertools.cycle(all_of_them), items))
