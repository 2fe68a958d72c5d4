"""Loops that many realisations take together, until all of them have finished."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir
from jaxtyping import Array, Bool

_State = TypeVar("_State")

_anywhere = Primitive("anywhere")
_anywhere.def_impl(lambda is_true: is_true)
_anywhere.def_abstract_eval(lambda is_true: is_true)
mlir.register_lowering(_anywhere, lambda _, is_true: [is_true])
batching.primitive_batchers[_anywhere] = lambda each, axes: (jnp.any(each[0], axis=axes[0]), None)


def loop_while_any(
    goes_on: Callable[[_State], Bool[Array, ""]], advance: Callable[[_State], _State], begin: _State
) -> _State:
    """`jax.lax.while_loop`, vectorised without a choice between old and new for each part of the state: `advance` must
    leave a state that does not go on as it is.
    """

    def step(carried: tuple[Array, _State]) -> tuple[Array, _State]:
        state = advance(carried[1])
        return _anywhere.bind(goes_on(state)), state

    return jax.lax.while_loop(lambda carried: carried[0], step, (_anywhere.bind(goes_on(begin)), begin))[1]
