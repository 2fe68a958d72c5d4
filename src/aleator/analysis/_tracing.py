"""Functions traced afresh at every use and compiled only when what they compute has changed.

A function may read globals or closures that change between two uses, so its identity says nothing about what it
computes. Its traced equations do: they are the key under which its compiled form is kept.
"""

from collections import OrderedDict
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
from jax.core import eval_jaxpr
from jax.extend.core import ClosedJaxpr

from aleator._core.arrays import Pytree
from aleator._core.equations import equations_text

# Enough for a session's functions; beyond, the one unused for longest is dropped.
_KEPT = 64
_EXECUTABLES: OrderedDict[str, Callable[..., list[Any]]] = OrderedDict()


class Traced(NamedTuple):
    """A function traced for the shapes of its arguments, ready to be evaluated; see `trace`."""

    closed: ClosedJaxpr
    structure: Any
    execute: Callable[..., list[Any]]

    def __call__(self, *arguments: Pytree) -> Pytree:
        """The function's value. Arguments and what the function holds may be traced by an outer transformation."""
        values = self.execute(self.closed.consts, *jax.tree.leaves(arguments))
        return jax.tree.unflatten(self.structure, values)


def trace(function: Callable[..., Pytree], *arguments: Pytree) -> Traced:
    """Trace a function of arrays. It is compiled when evaluated, unless the same equations have been before."""
    closed, shapes = jax.make_jaxpr(function, return_shape=True)(*arguments)
    key = equations_text(closed)
    if key is None or key not in _EXECUTABLES:
        jaxpr = closed.jaxpr
        execute = jax.jit(lambda constants, *leaves: eval_jaxpr(jaxpr, constants, *leaves))
        if key is None:
            return Traced(closed, jax.tree.structure(shapes), execute)
        _EXECUTABLES[key] = execute
    _EXECUTABLES.move_to_end(key)
    while len(_EXECUTABLES) > _KEPT:
        _EXECUTABLES.popitem(last=False)
    return Traced(closed, jax.tree.structure(shapes), _EXECUTABLES[key])


def evaluate(function: Callable[..., Pytree], *arguments: Pytree) -> Pytree:
    """A function of arrays, evaluated in compiled form."""
    return trace(function, *arguments)(*arguments)
