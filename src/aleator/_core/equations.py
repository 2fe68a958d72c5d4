"""What traced code computes, as a text: two functions of the same text compute, and differentiate, the same."""

import hashlib
import inspect
from collections.abc import Iterator
from functools import partial
from types import FunctionType
from typing import Any

import jax
import numpy as np
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr

# What equations that call Python code name it: `jax.pure_callback` and its like, and the rules of `jax.custom_vjp`.
_OPAQUE = {"callback", "bwd", "fwd_jaxpr_thunk"}

# Rules that say nothing beyond the equations, as JAX describes functions. Each is told by its very place: what JAX or a
# decorator wraps around a user's rule passes for a function of theirs.
_DERIVED: set[str] = set()


def equations_text(closed: ClosedJaxpr) -> str | None:
    """The equations of a traced function, and a digest of what does not show in them when they are printed.

    That is the arrays that inner functions hold, and the rules by which they are differentiated. Arrays that the
    outermost function holds are its constants, and no part of the text. None if the text cannot tell what is computed:
    where an inner function or a rule holds an array that is itself being traced, and where Python code is called, by
    `jax.pure_callback` or as the rules of `jax.custom_vjp`.
    """
    digest = hashlib.sha256()
    for part in _hidden(closed.jaxpr):
        if isinstance(part, Tracer) or callable(part):
            return None
        digest.update(part.encode() if isinstance(part, str) else array_digest(part).encode())
    return f"{closed.jaxpr}\n{digest.hexdigest()}"


def derived(rule: FunctionType) -> FunctionType:
    """A rule of a `jax.custom_jvp` function that holds nothing but what the function's own equations show."""
    code = inspect.unwrap(rule).__code__
    _DERIVED.add(f"{rule.__name__} at {code.co_filename}:{code.co_firstlineno}")
    return rule


def array_digest(array: Any) -> str:
    """Shape, type and values of an array as a short text."""
    values = np.asarray(array)
    return f"{values.shape}{values.dtype}{hashlib.sha256(values.tobytes()).hexdigest()}"


def _hidden(jaxpr: Any, *, rules: bool = True) -> Iterator[Any]:
    """What the printed equations do not show: arrays as they are, rules of differentiation as texts, in order.

    A rule may use the function that it belongs to, so that rules inside of rules are told by their place in the source.
    """
    for equation in jaxpr.eqns:
        if rules and equation.primitive.name == "custom_jvp_call":
            yield from _forward_rule(equation)
        if not _OPAQUE.isdisjoint(equation.params):
            yield _opaque
        for part in jax.tree.leaves(equation.params):
            if isinstance(part, ClosedJaxpr):
                yield from part.consts
                yield from _hidden(part.jaxpr, rules=rules)
            elif hasattr(part, "eqns"):
                yield from _hidden(part, rules=rules)
            elif hasattr(part, "debug_info"):
                yield str(part.debug_info.func_src_info)
            elif isinstance(part, FunctionType | partial):
                yield part


def _opaque() -> None:
    """Stands for Python code that is no function itself."""


def _forward_rule(equation: Any) -> Iterator[Any]:
    """The rule of a `jax.custom_jvp` function, traced: it may hold numbers that do not show in the source.

    One that is `derived` does not, and tracing it may take longer than tracing all the rest.
    """
    traced = equation.params["jvp_jaxpr_fun"]
    source = "" if traced.debug_info is None else traced.debug_info.func_src_info or ""
    if source in _DERIVED:
        yield source
        return
    variables = len(equation.invars) - equation.params["num_consts"]
    rule, held, *_ = traced.call_wrapped(*[False] * variables)
    yield str(rule)
    yield from held
    yield from _hidden(rule, rules=False)
