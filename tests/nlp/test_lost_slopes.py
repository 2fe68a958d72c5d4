"""An objective that changes without a slope is refused, where its decision acts smoothly on a limit."""

import jax.numpy as jnp
import pytest

import aleator as al


class Bar(al.AlgebraicSystem):
    """A bar whose cost is some function of its width."""

    width: al.Number
    load: al.Number
    kind: str

    def outputs(self):
        return {"stress": self.load / self.width, "cost": COSTS[self.kind](self.width)}


COSTS = {
    "hundredths": lambda width: jnp.round(width, 2),
    "never thinner": lambda width: jnp.maximum(width, 3.5),
}


def problem(kind):
    stress = al.output("stress")
    strong = (stress.mean + 3 * stress.std <= 0.5).named("stress")
    bar = Bar(al.Decision(4.0, 0.1, 10.0), al.Uniform(1.0, half_width=0.3), kind)
    return al.Problem(bar, minimize=al.output("cost").mean, subject_to=[strong])


def test_a_rounded_objective_is_refused_by_name():
    kind = "hundredths"
    with pytest.raises(al.ProblemError, match="changes with 'width', but all its derivatives tried are zero"):
        al.solve(problem(kind))
    assert any("by width" in one for one in al.examine(problem(kind)).wrong)


def test_an_objective_that_is_flat_in_part_is_solved():
    kind = "never thinner"
    assert al.solve(problem(kind)).objective == pytest.approx(3.5, rel=1e-9)
    assert not al.examine(problem(kind)).wrong


def test_a_search_compares_values_and_says_so():
    found = al.solve(problem("hundredths"), al.solvers.DifferentialEvolution(seed=1, evaluations=600))
    assert found.objective == pytest.approx(3.04, abs=1e-9)
    assert "values alone chose 'width'" in str(found.effort)
