"""Functions of the tests, compiled by the options of the package: ready sooner than by those of JAX."""

import contextlib
import logging
from collections.abc import Iterator
from functools import partial

import equinox as eqx
import jax
import numpy as np

from aleator._core.compilation import Use

_IS_CPU = jax.default_backend() == "cpu"

compiled = partial(jax.jit, compiler_options=Use.ONCE.value if _IS_CPU else {})
"""For a few runs: ready soonest."""


def answers(one, questions):
    """What an object answers to every question, by one program; its arrays are arguments, which XLA does not fold."""
    arrays, rest = eqx.partition(one, eqx.is_array)
    found = compiled(lambda arrays: [ask(eqx.combine(arrays, rest)) for ask in questions])(arrays)
    return jax.tree.map(np.asarray, found)


@contextlib.contextmanager
def programs_listed() -> Iterator[list[str]]:
    """What JAX compiles meanwhile, single operations included, whether or not its cache has it."""
    found: list[str] = []
    logger, handler = logging.getLogger("jax._src.interpreters.pxla"), logging.Handler()
    handler.emit = lambda record: found.extend([message for message in [record.getMessage()] if "Compiling" in message])
    level, passed_on = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.DEBUG)
    logger.propagate = False
    try:
        yield found
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        logger.propagate = passed_on
