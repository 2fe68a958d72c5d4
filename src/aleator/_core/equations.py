"""What traced code computes, as a text: two functions of the same text compute, and differentiate, the same."""

import hashlib
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr


def equations_text(closed: ClosedJaxpr) -> str | None:
    """The equations of a traced function, and a digest of what does not show in them when they are printed.

    That is the arrays that inner functions hold, and the rules of differentiation. A rule is told by its name and
    place in the source: its identity changes with each tracing. Arrays that the outermost function holds are its
    constants, and no part of the text. None if an inner function holds an array that is itself being traced.
    """
    digest = hashlib.sha256()
    for part in _hidden(closed.jaxpr):
        if isinstance(part, Tracer):
            return None
        digest.update(part.encode() if isinstance(part, str) else array_digest(part).encode())
    return f"{closed.jaxpr}\n{digest.hexdigest()}"


def array_digest(array: Any) -> str:
    """Shape, type and values of an array as a short text."""
    values = np.asarray(array)
    return f"{values.shape}{values.dtype}{hashlib.sha256(values.tobytes()).hexdigest()}"


def _hidden(jaxpr: Any) -> Iterator[Any]:
    """The arrays that functions inside the equations hold, and the places of rules of differentiation, in order."""
    for equation in jaxpr.eqns:
        for part in jax.tree.leaves(equation.params):
            if isinstance(part, ClosedJaxpr):
                yield from part.consts
                yield from _hidden(part.jaxpr)
            elif hasattr(part, "eqns"):
                yield from _hidden(part)
            elif hasattr(part, "debug_info"):
                yield str(part.debug_info.func_src_info)
