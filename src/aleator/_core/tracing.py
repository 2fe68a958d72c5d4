"""Functions of arrays in compiled form: traced once for each function object, compiled once for equal equations."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple, final

import jax
from jax.core import Tracer, eval_jaxpr
from jax.extend.core import ClosedJaxpr, Jaxpr

from aleator._core.arrays import Pytree
from aleator._core.compilation import Use, compiled_for
from aleator._core.devices import Device, here, placed
from aleator._core.equations import digest_of


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


# Enough for a session's functions.
_MOST = 64
_EXECUTED: OrderedDict[Hashable, _Executed] = OrderedDict()
_TRACED: "OrderedDict[Hashable, Traced]" = OrderedDict()
_LOCK = threading.Lock()


class Traced(NamedTuple):
    """A function traced for the shapes of its arguments, ready to be evaluated; see `trace`."""

    closed: ClosedJaxpr
    structure: Any
    execute: Callable[..., list[Any]]

    def __call__(self, *arguments: Pytree) -> Pytree:
        """The function's value. Arguments and closed-over values may be traced by an outer transformation."""
        values = self.execute(self.closed.consts, *jax.tree.leaves(arguments))
        return jax.tree.unflatten(self.structure, values)


def trace(function: Callable[..., Pytree], *arguments: Pytree, use: Use = Use.LOOPS) -> Traced:
    """Trace a function of arrays. It is compiled for a use when evaluated, unless the same equations were before.

    Constants of the function are arguments of its equations, so that other values compile nothing anew.
    """
    # A new function each time, because JAX caches traces by function.
    closed, shapes = jax.make_jaxpr(lambda *given: function(*given), return_shape=True)(*arguments)
    digest = digest_of(closed, constants=False)
    execute = _Executed(closed.jaxpr, use)
    if digest.is_whole:
        execute = _kept(_EXECUTED, (digest, use), execute)
    return Traced(closed, jax.tree.structure(shapes), execute)


def evaluate(function: Callable[..., Pytree], *arguments: Pytree, use: Use = Use.LOOPS) -> Pytree:
    """Evaluate a function of arrays in compiled form."""
    return trace(function, *arguments, use=use)(*arguments)


def trace_once(key: Hashable, function: Callable[..., Pytree], *arguments: Pytree, use: Use = Use.LOOPS) -> Traced:
    """The same as `trace`, once for each key and structure of the arguments: the function depends on these alone."""
    leaves, structure = jax.tree.flatten(arguments)
    whole = key, use, structure, tuple(jax.typeof(leaf) for leaf in leaves)
    try:
        known = _TRACED.get(whole)
    except TypeError:  # it has no hash
        return trace(function, *arguments, use=use)
    if known is None:
        known = trace(function, *arguments, use=use)
        if not any(isinstance(one, Tracer) for one in known.closed.consts):
            known = _kept(_TRACED, whole, known)
    return known


def _kept(known: OrderedDict[Hashable, Any], key: Hashable, made: Any) -> Any:
    """The value of a key if there is one already, else the new one; the least recently used are dropped."""
    with _LOCK:
        made = known.setdefault(key, made)
        known.move_to_end(key)
        while len(known) > _MOST:
            known.popitem(last=False)
        return made
