"""Digests of traced functions: two with the same digest have the same values and derivatives."""

import hashlib
import inspect
import itertools
from collections.abc import Iterator, Mapping
from functools import partial
from types import FunctionType
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr

# Parameters of equations that hold Python code: of `jax.pure_callback` and the like, and rules of `jax.custom_vjp`.
_OPAQUE = {"callback", "bwd", "fwd_jaxpr_thunk"}

# Rules that add nothing to the equations, as JAX describes functions. Each is identified by its place in the source: a
# user's rule that JAX or a decorator wraps would otherwise pass for a function of theirs.
_DERIVED: set[str] = set()


class Digest(NamedTuple):
    """What tells equations apart.

    - `text`: equal for equal equations, in any process; `is_whole`: whether they show all that is computed. They do not
      if they call Python code, by `jax.pure_callback` or as the rules of `jax.custom_vjp`.
    """

    text: str
    is_whole: bool


def digest_of(closed: ClosedJaxpr, *, constants: bool = True) -> Digest:
    """The digest of a traced function: of its equations, the inner arrays and rules of these, and its `constants`."""
    digest, is_whole = hashlib.sha256(str(closed.jaxpr).encode()), True
    for part in itertools.chain(closed.consts if constants else (), _hidden(closed.jaxpr)):
        if isinstance(part, Tracer) or callable(part):
            is_whole = False
            break
        digest.update(part.encode() if isinstance(part, str) else array_digest(part).encode())
    return Digest(digest.hexdigest(), is_whole)


def joint_digest(parts: Mapping[str, Digest]) -> Digest:
    """One digest of several, by name."""
    text = "\n".join(f"{name} {one.text}" for name, one in parts.items())
    return Digest(hashlib.sha256(text.encode()).hexdigest(), all(one.is_whole for one in parts.values()))


def derived(rule: FunctionType) -> FunctionType:
    """Mark a rule of a `jax.custom_jvp` function that holds nothing beyond the function's own equations."""
    code = inspect.unwrap(rule).__code__
    _DERIVED.add(f"{rule.__name__} at {code.co_filename}:{code.co_firstlineno}")
    return rule


def array_digest(array: Any) -> str:
    """Shape, type and values of an array as a short text."""
    values = np.asarray(array)
    return f"{values.shape}{values.dtype}{hashlib.sha256(values.tobytes()).hexdigest()}"


def _hidden(jaxpr: Any, *, rules: bool = True) -> Iterator[Any]:
    """The parts that printed equations do not show: arrays, and rules of differentiation as texts, in order.

    A rule may use its own function, so that rules inside rules are identified by their place in the source.
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
    """A placeholder for callable objects that are no Python functions."""


def _forward_rule(equation: Any) -> Iterator[Any]:
    """The traced rule of a `jax.custom_jvp` function, because it may hold numbers that the source does not show.

    A `derived` one does not, and tracing it may take longer than all the rest.
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
