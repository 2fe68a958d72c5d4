"""What every other part may use: array types and errors. Switches JAX to 64 bit, here and nowhere else."""

import jax

jax.config.update("jax_enable_x64", True)
