"""Designs whose outputs are expanded in elements, against closed forms and published numbers."""

import jax.numpy as jnp
import pytest

import aleator as al


class Kinked(al.AlgebraicSystem):
    first: al.Number
    second: al.Number
    away: al.Number

    def outputs(self):
        return {"larger": jnp.maximum(self.first, self.second) - self.away, "off": jnp.abs(self.first - self.away)}


def test_elements_are_divided_where_the_kink_is_at_the_answer():
    """`E|u - a|` for a uniform `u` is `(a² + (1 - a)²) / 2`."""
    off, away = al.output("off"), al.value("away")
    problem = al.Problem(
        Kinked(al.Uniform.bounds(0.0, 1.0), 0.0, al.Decision(0.05, 0.0, 1.0)),
        minimize=-away,
        subject_to=[away <= 0.7, off.mean <= 1.0, off.probability(above=0.5) <= 1.0],
        expansion=al.MultiElement(3, error=1e-3),
    )
    solution = al.solve(problem)
    cells = solution.problem.expansion.cells
    assert min(one.high[0] - one.low[0] for one in cells if one.low[0] <= 0.7 <= one.high[0]) < 0.05
    values = [one.values[0] for one in solution.constraints[1:]]
    assert values == pytest.approx([(0.7**2 + 0.3**2) / 2, 0.2], abs=1e-4)


class Bowl(al.AlgebraicSystem):
    first: al.Number
    away: al.Number
    factor: al.Number

    def outputs(self):
        return {"bowl": self.factor * (self.first - self.away) ** 2}


def test_what_is_smooth_is_designed_in_one_element():
    """`E(u - a)² = (a - 1/2)² + 1/12` is least at the middle, whatever an unknown factor is."""
    bowl = Bowl(al.Uniform.bounds(0.0, 1.0), al.Decision(0.3, 0.0, 1.0), al.Interval(0.5, 1.0))
    solution = al.solve(al.Problem(bowl, minimize=al.output("bowl").mean, expansion=al.MultiElement(2)))
    assert solution.certificate.expansion.elements == 1
    assert (solution.decisions["away"], solution.objective) == pytest.approx((0.5, 1 / 12), abs=1e-7)


class Threshold(al.AlgebraicSystem):
    """What is 1 above a threshold, and something that grows with it."""

    load: al.Number
    threshold: al.Number
    width: float | None = None
    rate: al.Number = 0.2

    def outputs(self):
        above = self.load - self.threshold
        jump = jnp.where(above > 0, 1.0, 0.0) if self.width is None else al.smooth.step(above, width=self.width)
        return {"cost": jump + self.rate * self.threshold, "bowl": jump + 5 * (self.threshold - 0.6) ** 2}


def with_threshold(output, threshold, width=None, rate=0.2):
    return al.Problem(
        Threshold(al.Uniform.bounds(0.0, 1.0), threshold, width, rate),
        minimize=al.output(output).mean,
        expansion=al.MultiElement(2, error=1e-3),
    )


LOW = al.Decision(0.5, 0.5, 0.9)


def test_a_jump_that_a_decision_moves_is_refused():
    """The mean cost of a load between 0 and 1 is `1 - 0.8 d`: by derivatives at fixed points it grows by `0.2 d`."""
    with pytest.raises(al.SolveError, match=r"derivatives leave out how a jump moves.*al\.smooth\.step"):
        al.solve(with_threshold("cost", LOW))


@pytest.mark.slow
def test_a_jump_that_a_decision_moves_is_followed_where_it_is_smooth_and_refused_inside_bounds_too():
    smooth = al.solve(with_threshold("cost", LOW, 0.01))
    assert (float(smooth.decisions["threshold"]), smooth.objective) == pytest.approx((0.9, 0.28), abs=1e-3)
    # Inside its bounds `1 - d + 5 (d - 0.6)²` is least at 0.7, where derivatives at fixed points say 0.6.
    with pytest.raises(al.SolveError, match="leave out how a jump moves"):
        al.solve(with_threshold("bowl", al.Decision(0.0, 0.0, 1.0)))
