"""Code that JAX cannot vectorise or differentiate, named in a sentence that says what to write instead."""

from collections.abc import Iterator
from contextlib import contextmanager

from aleator._core.errors import ProblemError

# By words of JAX's own errors.
_REMEDIES = {
    "custom_vjp": "'jax.custom_vjp', whose derivatives are taken backward alone; the program's are taken forward too: "
    "write the rule by 'jax.custom_jvp'",
    "pure_callback primitive": "'jax.pure_callback' for one realisation at a time; many are computed at once: give "
    "it a 'vmap_method', such as 'sequential'",
    "Pure callbacks do not support JVP": "'jax.pure_callback', which has no derivatives: give them by 'jax.custom_jvp'",
}


@contextmanager
def explained() -> Iterator[None]:
    """Raise `ProblemError` in the place of an error of JAX about equations that have no derivatives, or no batches."""
    try:
        yield
    except (TypeError, ValueError, NotImplementedError) as error:
        for words, remedy in _REMEDIES.items():
            if words in str(error):
                raise ProblemError(f"The equations use {remedy}.") from error
        raise
