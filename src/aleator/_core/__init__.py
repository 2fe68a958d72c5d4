"""Foundations for all other parts. Only this module configures JAX: 64 bit, and the folder of compiled programs."""

import jax

jax.config.update("jax_enable_x64", True)

from aleator._core.store import keep_by_default as _keep_by_default  # noqa: E402

_keep_by_default()
