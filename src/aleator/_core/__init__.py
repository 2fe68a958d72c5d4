"""Foundations for all other parts. Only this module configures JAX: 64 bit, and the folder of compiled programs."""

import jax

jax.config.update("jax_enable_x64", True)

from aleator._core.programs import keep_by_default as _keep_by_default  # noqa: E402

_keep_by_default()

import_seconds = 0.0
"""The time that the import of the package took, part of every solution's times."""
