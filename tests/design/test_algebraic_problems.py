import re

import numpy as np
import pytest

import aleator as al
from zoo import ONE_STEP, Hardening, deflection, gain_problem, optimum, sine

X = al.output("x")
# The force that deflects the spring by 1.1.
FORCE = 1.1 + 1.1**3
SYSTEM = Hardening(a=al.Uniform(2.0, half_width=al.Decision(0.2, 0.01, 1.5)))


def tolerance_problem(limit, **options):
    """The cheapest tolerance on the force, around 2, that keeps the deflection below a limit."""
    cost = al.cost.reciprocal("a.half_width", bias=1.0, scale=0.5)
    return al.Problem(SYSTEM, minimize=cost, subject_to=[limit], **options)


def test_an_algebraic_problem_prints_as_mathematics():
    problem = tolerance_problem(X.at_most(1.1, sigmas=2.0))
    assert str(problem) == "\n".join(
        [
            "minimise    (0.5/a.half_width + 1)",
            "over        a.half_width ∈ [0.01, 1.5], from 0.2",
            "subject to  x: μ[x] + 2 σ[x] ≤ 1.1",
            "where       a ~ Uniform(mean=2, half_width=Decision(0.2 in [0.01, 1.5]))",
            "equations   Hardening(x), solved by Newton's method",
            "expansion   order 3 in 1 variables, TotalDegree index set, HammersleyPoints, LeastSquares fit",
        ]
    )


@pytest.mark.parametrize(
    ("declare", "message"),
    [
        (lambda: al.Problem(SYSTEM, minimize=al.integral("x").mean), r"Hardening is algebraic.*al\.output\('x'\)"),
        (
            lambda: al.Problem(gain_problem().system, grid=ONE_STEP, minimize=al.output("loss").mean),
            r"Gain evolves in time.*al\.terminal\('loss'\)",
        ),
        (lambda: al.Problem(SYSTEM, minimize=X.mean, grid=al.Grid(1.0, 2)), "drop the grid"),
        (lambda: al.Problem(SYSTEM, minimize=X.mean, inputs={"f": sine()}), r"takes no inputs; received \['f'\]"),
    ],
    ids=["over time", "without time", "a grid", "inputs"],
)
def test_a_problem_that_does_not_fit_its_kind_of_system_is_refused(declare, message):
    with pytest.raises(al.ProblemError, match=message):
        declare()


@pytest.mark.slow
def test_a_margin_on_a_deflection_gives_the_tolerance_of_exact_quadrature_and_evidence_counts_it():
    solution = al.solve(tolerance_problem(X.at_most(1.1, sigmas=1.0), expansion=al.Expansion(6)))
    width = solution.decisions["a.half_width"]
    nodes, weights = np.polynomial.legendre.leggauss(40)
    values = deflection(2.0 + width * nodes)
    mean = weights @ values / 2
    assert mean + np.sqrt(weights @ (values - mean) ** 2 / 2) == pytest.approx(1.1, rel=1e-6)
    assert solution.objective == pytest.approx(1.0 + 0.5 / width, rel=1e-9)
    assert solution.active == ("x",)
    assert solution.constraints[0].times is None
    assert solution.statistics["μ[x]"] == pytest.approx(mean, rel=1e-6)
    evidence = al.validate(solution, 4000, seed=2)
    assert evidence.violations["x"].lower <= (2.0 + width - FORCE) / (2 * width) <= evidence.violations["x"].upper
    assert evidence.trajectories == ()


def test_the_tolerance_of_an_assembly_is_that_of_its_closed_form():
    """The one-way clutch (dissertation, section 5.6): how wide the tolerance of the hub may be."""
    clutch = al.Assembly(
        dimensions={
            "a": al.Normal(27.645, al.Decision(0.02, 0.001, 0.3)),
            "c": al.Normal(11.43, 0.0033),
            "e": al.Normal(50.8, 0.0042),
        },
        unknowns={"b": 4.8, "chi": 7.0},
        loops=[[("a", 90), ("b", 0), ("c", 90), ("c", "90 - chi"), ("-e", "90 - chi")]],
    )
    cost = al.cost.reciprocal("a.std", bias=0.1, scale=0.001)
    limit = al.output("chi").within(6.5, 7.5, sigmas=3.0)
    std = optimum(al.Problem(clutch, minimize=cost, subject_to=[limit])).decisions["a.std"]
    nodes, weights = np.polynomial.hermite_e.hermegauss(12)
    a, c, e = np.meshgrid(27.645 + std * nodes, 11.43 + 0.0033 * nodes, 50.8 + 0.0042 * nodes, indexing="ij")
    weight = np.prod(np.meshgrid(weights, weights, weights, indexing="ij"), axis=0) / (2 * np.pi) ** 1.5
    angle = np.rad2deg(np.arccos((a + c) / (e - c)))
    mean = np.sum(weight * angle)
    spread = np.sqrt(np.sum(weight * (angle - mean) ** 2))
    ends = [(mean + 3 * spread - 7.5) / spread, (6.5 - mean + 3 * spread) / spread]
    assert max(ends) == pytest.approx(0.0, abs=1e-4)


class Fold(al.AlgebraicSystem):
    """`x² = b - a`: no solution where the load `a` exceeds `b`."""

    unknowns = ("x",)
    a: float
    b: float

    def guess(self):
        return {"x": 1.0}

    def residual(self, rho):
        return (rho.x**2 + self.a - self.b,)


def test_equations_without_a_solution_are_reported_with_point_and_residual():
    problem = al.Problem(
        Fold(al.Uniform(1.0, half_width=0.5), al.Decision(1.3, 1.0, 1.4)), minimize=al.output("x").mean
    )
    with pytest.raises(al.SimulationError) as caught:
        al.solve(problem)
    message = str(caught.value)
    assert re.match(
        r"Fold: Newton found no solution.*collocation point \d+ of 12 \(a = 1\.[345]\d*\).*decisions are b = 1\.3",
        message,
    )
    assert "residual" in message
