"""Functions of the tests, compiled by the options of the package: ready sooner than by those of JAX."""

from functools import partial

import equinox as eqx
import jax

from aleator._core.compilation import Use

_IS_CPU = jax.default_backend() == "cpu"

compiled = partial(jax.jit, compiler_options=Use.ONCE.value if _IS_CPU else {})
"""For a few runs: ready soonest."""


def answers(one, questions):
    """What an object answers to every question, by one program; its arrays are arguments, which XLA does not fold."""
    arrays, rest = eqx.partition(one, eqx.is_array)
    return compiled(lambda arrays: [ask(eqx.combine(arrays, rest)) for ask in questions])(arrays)
