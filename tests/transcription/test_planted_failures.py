"""Where some systems fail, a design has no value: no statistic hides them from the solver."""

import jax.numpy as jnp
import numpy as np

import aleator as al
from aleator.transcription import transcribe


class Root(al.AlgebraicSystem):
    """A root that negative numbers do not have, and a cost of its own."""

    size: al.Number
    off: al.Number

    def outputs(self):
        return {"root": jnp.sqrt(self.size + self.off), "size": self.size}


def test_a_failed_system_leaves_a_design_without_any_value():
    model = Root(al.Decision(2.0, 0.1, 5.0), al.Uniform(0.0, half_width=1.0))
    likely = al.output("root").probability(above=3.0) <= 0.1
    program = transcribe(al.Problem(model, minimize=al.output("size").mean, subject_to=[likely])).program
    for size, is_finite in ((2.0, True), (0.5, False)):
        found = program.evaluate(np.array([size]))
        assert np.isfinite(np.append(found.constraints, found.objective)).all() == is_finite
        assert np.isnan(found.objective) != is_finite
