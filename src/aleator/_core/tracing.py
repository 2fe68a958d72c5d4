"""Functions traced again if their code may have changed, and compiled only if their equations have.

A function may read globals or closures that change between two uses, so that its identity does not determine what it
computes. Its traced equations do: they are the key of its compiled form.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import partial
from typing import Any, Generic, NamedTuple, TypeVar, final

import jax
from jax.core import Tracer, eval_jaxpr
from jax.extend.core import ClosedJaxpr, Jaxpr

from aleator._core.arrays import Pytree
from aleator._core.code import read_code
from aleator._core.compilation import Use, compiled_for
from aleator._core.devices import Device, here, placed
from aleator._core.equations import array_digest, equations_text
from aleator._core.purity import steadily

_Kept = TypeVar("_Kept")


@final
class _Memory(Generic[_Kept]):
    """A cache of values for the most recently used keys, shared by threads."""

    def __init__(self, most: int):
        self._most, self._lock = most, threading.Lock()
        self._made: OrderedDict[Hashable, _Kept] = OrderedDict()

    def __len__(self) -> int:
        return len(self._made)

    def get(self, key: Hashable) -> _Kept | None:
        """The value of a key; None if there is none."""
        with self._lock:
            if key in self._made:
                self._made.move_to_end(key)
            return self._made.get(key)

    def kept(self, key: Hashable, made: _Kept) -> _Kept:
        """The value of a key if there is one already, else the new one."""
        with self._lock:
            made = self._made.setdefault(key, made)
            self._made.move_to_end(key)
            while len(self._made) > self._most:
                self._made.popitem(last=False)
            return made


@final
class _Executed:
    """Equations to be evaluated: compiled for one use, or as part of an outer transformation's trace."""

    def __init__(self, jaxpr: Jaxpr, use: Use):
        self._within = jax.jit(lambda constants, *leaves: eval_jaxpr(jaxpr, constants, *leaves))
        self._use, self._lock = use, threading.Lock()
        self._compiled: dict[Device, Callable[..., list[Any]]] = {}

    def __call__(self, constants: list[Any], *leaves: Any) -> list[Any]:
        if any(isinstance(one, Tracer) for one in (*constants, *leaves)):
            return self._within(constants, *leaves)
        device = placed((constants, leaves)) or here()
        with self._lock:
            if device not in self._compiled:
                lowered = self._within.lower(constants, *leaves)
                self._compiled[device] = compiled_for(self._use, lowered, device.platform)
        return self._compiled[device](constants, *leaves)


# Size of the cache: enough for a session's functions.
_EXECUTABLES: _Memory[_Executed] = _Memory(64)
_TRACED: "_Memory[Traced]" = _Memory(64)


class Traced(NamedTuple):
    """A function traced for the shapes of its arguments, ready to be evaluated; see `trace`."""

    closed: ClosedJaxpr
    structure: Any
    execute: Callable[..., list[Any]]

    def __call__(self, *arguments: Pytree) -> Pytree:
        """The function's value. Arguments and closed-over values may be traced by an outer transformation."""
        values = self.execute(self.closed.consts, *jax.tree.leaves(arguments))
        return jax.tree.unflatten(self.structure, values)


def trace(
    function: Callable[..., Pytree], *arguments: Pytree, code: Pytree = None, name: str = "", use: Use = Use.LOOPS
) -> Traced:
    """Trace a function of arrays. It is compiled when evaluated, unless the same equations were before.

    `code` is its part written by a user, called `name`: raises `ProblemError` if that computes something different at
    each call. `use` is the use that it is compiled for.
    """

    def traced() -> tuple[ClosedJaxpr, Any]:
        # A new function each time, because JAX caches traces by function.
        return jax.make_jaxpr(lambda *given: function(*given), return_shape=True)(*arguments)

    (closed, shapes), _ = steadily(name, code, traced, lambda found: _told(found[0]))
    key, execute = equations_text(closed), _Executed(closed.jaxpr, use)
    if key is not None:
        execute = _EXECUTABLES.kept((key, use), execute)
    return Traced(closed, jax.tree.structure(shapes), execute)


def _told(closed: ClosedJaxpr) -> Any:
    """A key of the computation, as far as it is known while an outer transformation may be tracing constants."""
    known = [None if isinstance(one, Tracer) else array_digest(one) for one in closed.consts]
    return equations_text(closed), known


def trace_kept(
    function: Callable[..., Pytree], *arguments: Pytree, code: Pytree, static: Pytree, name: str, use: Use = Use.LOOPS
) -> Traced:
    """The same as `trace`, which takes longer than most evaluations and is left out if an earlier trace holds.

    It holds for arguments of the same shapes, as long as everything that the user's part of the function, `code`, and
    the `static` part of its model read is the same. The function must depend on these alone.
    """
    make = partial(trace, function, *arguments, code=code, name=name, use=use)
    return _unless_known(make, (code, static), _exactly(static), arguments, use)


def evaluate(function: Callable[..., Pytree], *arguments: Pytree, use: Use = Use.LOOPS) -> Pytree:
    """Evaluate a function of arrays in compiled form; it is traced again if its code may have changed."""
    make = partial(trace, function, *arguments, use=use)
    return _unless_known(make, function, None, arguments, use)(*arguments)


def _unless_known(make: Callable[[], Traced], code: Pytree, static: Hashable, arguments: Pytree, use: Use) -> Traced:
    """A trace that was made while the code read the same, else a new one, which is kept if it may be."""
    reading = read_code(code)
    leaves, structure = jax.tree.flatten(arguments)
    key = use, reading.reads, static, structure, tuple(jax.typeof(leaf) for leaf in leaves)
    if reading.doubts or not _has_hash(key):
        return make()
    known = _TRACED.get(key)
    if known is None:
        known = make()
        if not any(isinstance(one, Tracer) for one in known.closed.consts):
            _TRACED.kept(key, known)
    return known


def _exactly(static: Pytree) -> Hashable:
    """Equal for equal structures: 1, 1.0 and True differ, and so do 0.0 and -0.0."""
    leaves, structure = jax.tree.flatten(static)
    return structure, tuple((type(one), one.hex() if isinstance(one, float) else one) for one in leaves)


def _has_hash(key: Any) -> bool:
    try:
        hash(key)
    except TypeError:
        return False
    return True
