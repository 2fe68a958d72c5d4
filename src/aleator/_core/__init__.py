"""What every other part may use: array types and errors. Sets JAX up, here and nowhere else: 64 bit, and where
compiled programs are kept.
"""

import jax

jax.config.update("jax_enable_x64", True)

from aleator._core.kept_programs import keep_by_default as _keep_by_default  # noqa: E402

_keep_by_default()
