"""Functions of the tests, compiled by the options of the package: ready sooner than by those of JAX."""

from functools import partial

import jax

from aleator._core.compilation import Use

_IS_CPU = jax.default_backend() == "cpu"

compiled = partial(jax.jit, compiler_options=Use.ONCE.value if _IS_CPU else {})
"""For a few runs: ready soonest."""
