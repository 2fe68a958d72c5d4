import re

import numpy as np
import pytest

import aleator as al
from zoo import ONE_STEP, Hardening, Oscillator, bar_problem, deflection, gain_problem, optimum, sine

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
            "minimise    (1 + 0.5/a.half_width)",
            "over        a.half_width ∈ [0.01, 1.5], from 0.2",
            "subject to  x: μ[x] + 2 σ[x] ≤ 1.1",
            "where       a ~ Uniform(mean=2, half_width=Decision(0.2 in [0.01, 1.5]))",
            "equations   Hardening(x), solved by Newton's method",
            "expansion   order 3 in 1 variables, TotalDegree index set, HammersleyPoints, LeastSquares fit",
        ]
    )
    assert str(al.deterministic(problem)).endswith("every σ is 0")
    assert "equations   Bar, in closed form" in str(bar_problem())


@pytest.mark.parametrize(
    ("declare", "message"),
    [
        *[
            (
                lambda functional=functional: al.Problem(SYSTEM, minimize=functional("x").mean),
                r"is taken over time, but Hardening is algebraic.*use al\.output\('x'\)",
            )
            for functional in (al.integral, al.rms, al.peak, al.path, al.terminal)
        ],
        (
            lambda: al.Problem(gain_problem().system, grid=ONE_STEP, minimize=al.output("loss").mean),
            r"Gain evolves in time.*al\.terminal\('loss'\)",
        ),
        (
            lambda: al.Problem(SYSTEM, minimize=X.mean, grid=al.Grid(1.0, 2)),
            "'grid' must be a Instant; received Grid .*drop the grid",
        ),
        (lambda: al.Problem(SYSTEM, minimize=X.mean, inputs={"f": sine()}), r"takes no inputs; received \['f'\]"),
        (lambda: al.Problem(SYSTEM, minimize=al.output("y").mean), "no output of Hardening 'y'"),
        (
            lambda: al.Problem(Oscillator(1.0, 1.0, 1.0), minimize=al.rms("x").mean, inputs={"force": sine()}),
            "'grid' must be a Grid; received NoneType None",
        ),
    ],
)
def test_an_algebraic_problem_that_does_not_fit_together_is_refused(declare, message):
    with pytest.raises(al.ProblemError, match=message):
        declare()


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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("limit", "width"),
    [
        # The largest force, the one at the level 0.99, and the one exceeded with probability 0.05 deflect by 1.1.
        (X.at_most(1.1, worst_case=True), FORCE - 2.0),
        (X.at_most(1.1, probability=0.99), (FORCE - 2.0) / 0.98),
        (X.probability(above=1.1) <= 0.05, (FORCE - 2.0) / 0.9),
    ],
    ids=str,
)
def test_a_tolerance_under_any_kind_of_limit_is_its_closed_form(limit, width):
    found = optimum(tolerance_problem(limit, expansion=al.Expansion(5)))
    assert found.decisions["a.half_width"] == pytest.approx(width, rel=1e-4)


def test_a_deterministic_algebraic_problem_stands_at_the_mean():
    problem = al.Problem(
        Hardening(a=al.Uniform(al.Decision(1.0, 0.1, 9.0), half_width=0.1)),
        minimize=-al.output("force").mean,
        subject_to=[X.at_most(1.1, sigmas=3.0)],
    )
    assert optimum(al.deterministic(problem)).decisions["a.mean"] == pytest.approx(1.1 + 1.1**3, rel=1e-8)


def strut_angle(a, c, e):
    """The angle of the one-way clutch, in degrees."""
    return np.rad2deg(np.arccos((a + c) / (e - c)))


def clutch_problem():
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
    return al.Problem(
        clutch,
        minimize=al.cost.reciprocal("a.std", bias=0.1, scale=0.001),
        subject_to=[al.output("chi").within(6.5, 7.5, sigmas=3.0)],
    )


def test_the_tolerance_of_an_assembly_is_that_of_its_closed_form():
    std = optimum(clutch_problem()).decisions["a.std"]
    nodes, weights = np.polynomial.hermite_e.hermegauss(12)
    a, c, e = np.meshgrid(27.645 + std * nodes, 11.43 + 0.0033 * nodes, 50.8 + 0.0042 * nodes, indexing="ij")
    weight = np.prod(np.meshgrid(weights, weights, weights, indexing="ij"), axis=0) / (2 * np.pi) ** 1.5
    angle = strut_angle(a, c, e)
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
        r"Fold: Newton found no solution.*collocation point \d+ of 12 \(a=1\.[345]\d*\).*decisions are b=1\.3", message
    )
    assert "residual" in message


@pytest.mark.slow
def test_a_sampled_system_without_a_solution_is_reported_with_its_residual():
    problem = al.Problem(
        Fold(al.Normal(1.0, 0.15), al.Decision(1.5, 1.45, 1.55)),
        minimize=al.output("x").mean,
        expansion=al.Expansion(1, points=3, tolerance=0.5),
    )
    # Already the tails of the fresh systems tell of it.
    beyond = (
        r"x is not finite in about 0\.\d+ % of all systems, such as that with a=1\.\d+\. Mend the model there, or bound"
    )
    with pytest.warns(al.ExpansionWarning, match=beyond):
        solution = al.solve(problem)
    message = r"system with a=1\.\d+ is not finite: output 'x'\. Fold: Newton found no solution"
    with pytest.raises(al.SimulationError, match=message):
        al.validate(solution, 20_000, seed=1)
