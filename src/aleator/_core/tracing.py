"""Functions traced afresh at every use and compiled only when what they compute has changed.

A function may read globals or closures that change between two uses, so its identity says nothing about what it
computes. Its traced equations do: they are the key under which its compiled form is kept.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
from jax.core import Tracer, eval_jaxpr
from jax.extend.core import ClosedJaxpr

from aleator._core.arrays import Pytree
from aleator._core.equations import array_digest, equations_text
from aleator._core.purity import steadily

# Enough for a session's functions; beyond, the one unused for longest is dropped.
_KEPT = 64
_EXECUTABLES: OrderedDict[str, Callable[..., list[Any]]] = OrderedDict()
_LOCK = threading.Lock()


class Traced(NamedTuple):
    """A function traced for the shapes of its arguments, ready to be evaluated; see `trace`."""

    closed: ClosedJaxpr
    structure: Any
    execute: Callable[..., list[Any]]

    def __call__(self, *arguments: Pytree) -> Pytree:
        """The function's value. Arguments and what the function holds may be traced by an outer transformation."""
        values = self.execute(self.closed.consts, *jax.tree.leaves(arguments))
        return jax.tree.unflatten(self.structure, values)


def trace(function: Callable[..., Pytree], *arguments: Pytree, code: Pytree = None, name: str = "") -> Traced:
    """Trace a function of arrays. It is compiled when evaluated, unless the same equations have been before.

    `code` is what of it is written by a user, called `name`: raises `ProblemError` if that computes something else each
    time.
    """

    def traced() -> tuple[ClosedJaxpr, Any]:
        # A new function each time: JAX remembers the traces of those that it has seen.
        return jax.make_jaxpr(lambda *given: function(*given), return_shape=True)(*arguments)

    (closed, shapes), _ = steadily(name, code, traced, lambda found: _told(found[0]))
    key, jaxpr = equations_text(closed), closed.jaxpr
    execute = jax.jit(lambda constants, *leaves: eval_jaxpr(jaxpr, constants, *leaves))
    if key is not None:
        with _LOCK:
            execute = _EXECUTABLES.setdefault(key, execute)
            _EXECUTABLES.move_to_end(key)
            while len(_EXECUTABLES) > _KEPT:
                _EXECUTABLES.popitem(last=False)
    return Traced(closed, jax.tree.structure(shapes), execute)


def _told(closed: ClosedJaxpr) -> Any:
    """What is computed, as far as it can be told while an outer transformation may be tracing constants."""
    known = [None if isinstance(one, Tracer) else array_digest(one) for one in closed.consts]
    return equations_text(closed), known


def evaluate(function: Callable[..., Pytree], *arguments: Pytree) -> Pytree:
    """A function of arrays, evaluated in compiled form."""
    return trace(function, *arguments)(*arguments)
