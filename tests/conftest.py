"""Array shapes checked at run time, rank promotion refused: for every test, before `aleator` is imported."""

import jax
from jaxtyping import install_import_hook

# The hook rewrites modules as they are imported: it must come first. Uncertainty, collocation and statistics are left
# out: written for JAX arrays, they rightly work on plain floats and NumPy arrays too, on which their tests call them,
# and a check of array types would refuse those.
CHECKED = [
    f"aleator.{part}"
    for part in (
        "trajectories",
        "dynamics",
        "mechanics",
        "geometry",
        "design",
        "nlp",
        "transcription",
        "solve",
        "validation",
        "sweep",
    )
]
install_import_hook(CHECKED, "shape_checker.check")

jax.config.update("jax_numpy_rank_promotion", "raise")
