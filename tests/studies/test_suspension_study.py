"""The suspension study: its model against plain NumPy, its designs against another program, and the whole run."""

import importlib
import inspect
from functools import cache

import numpy as np
import pytest

import aleator as al
from aleator.design import responses
from aleator.studies import suspension
from aleator.studies.suspension import apportionment_problem, deterministic_problem, robust_problem
from aleator.transcription import transcribe
from aleator.uncertainty import LegendreGerm
from compiling import compiled
from numpy_quarter_car import quarter_car
from zoo import derivative_error, optimum

SOLVERS = {"FilterSQP": al.solvers.FilterSQP(), "Ipopt": al.solvers.Ipopt(), "Slsqp": al.solvers.Slsqp()}
PROBLEMS = {
    "dOpt": deterministic_problem,
    "uOpt": robust_problem,
    "aOpt": apportionment_problem,
    "uOpt, narrow": lambda: robust_problem(travel=0.152),
}


@cache
def design(name):
    return al.solve(PROBLEMS[name]())


@cache
def best(name):
    return optimum(PROBLEMS[name]())


def test_the_study_is_a_short_module_that_is_found_by_name():
    module = importlib.import_module("aleator.studies.suspension")
    assert len(inspect.getsource(module).splitlines()) < 200


def test_the_road_is_the_documented_one():
    road = suspension.road()
    assert road.values.shape == (2801,)
    np.testing.assert_allclose(np.diff(road.times), 1e-3, rtol=1e-9)
    assert road.span() == (0.0, 2.8)


def test_the_problems_read_as_in_the_chapter():
    robust, apportioned = str(robust_problem()), str(apportionment_problem())
    assert "minimise    μ[∫comfort dt] + σ[∫comfort dt]" in robust
    assert "travel: μ[z_s(t)] + σ[z_s(t)] − μ[z_u(t)] + σ[z_u(t)] ≤ 0.203 for all t" in robust
    assert "travel: μ[z_s(t)] − σ[z_s(t)] − μ[z_u(t)] − σ[z_u(t)] ≥ -0.203 for all t" in robust
    assert "holding: μ[rms(grip)] + σ[rms(grip)] ≤ 0.034" in robust
    assert "order 3 in 5 variables, TotalDegree index set" in robust
    assert "(0.5 + 1.4e+06/k_s.half_width^1.5)" in apportioned
    assert "ride: μ[∫comfort dt] + σ[∫comfort dt] ≤ 220" in apportioned


def test_an_independent_simulation_reproduces_ride_travel_and_holding():
    problem = robust_problem()
    generator = np.random.default_rng(4)
    germ = generator.uniform(-1, 1, (5, 5))
    decisions = np.array([31_000.0, 1500.0])
    mean, width = np.array([376.0, *decisions, 1.39, 200e3]), np.array([47.0, 3750.0, 250.0, 0.17375, 25e3])
    functionals = (al.integral("comfort"), al.rms("grip"), al.path("travel"))
    ours = compiled(lambda germ, decisions: responses(problem, functionals, germ, decisions))(germ, decisions)
    ride, holding, travel = quarter_car(*(mean + width * germ).T)
    np.testing.assert_allclose(ours[0], ride, rtol=1e-10)
    np.testing.assert_allclose(ours[1], holding, rtol=1e-10)
    np.testing.assert_allclose(ours[2], travel.T, atol=1e-10 * np.abs(travel).max())


@pytest.mark.slow
def test_the_expansion_agrees_with_tensor_gauss_quadrature():
    nodes, weights = LegendreGerm().gauss(5)
    grid = np.stack([axis.ravel() for axis in np.meshgrid(*[nodes] * 5, indexing="ij")])
    weight = np.prod(np.meshgrid(*[weights] * 5, indexing="ij"), axis=0).ravel()
    mean, width = np.array([376.0, 30e3, 2000.0, 1.39, 200e3]), np.array([47.0, 3750.0, 250.0, 0.17375, 25e3])
    ride = quarter_car(*(mean + width * grid.T).T)[0]
    expected = weight @ ride
    spread = np.sqrt(weight @ (ride - expected) ** 2)
    transcription = transcribe(robust_problem())
    moments = transcription.resolve(np.array([30e3, 2000.0]))["∫comfort dt"]
    assert float(moments.mean) == pytest.approx(expected, rel=1e-4)
    assert float(moments.std) == pytest.approx(spread, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("declare", [robust_problem, apportionment_problem], ids=["uOpt", "aOpt"])
def test_derivatives_of_every_objective_and_constraint_agree_with_central_differences(declare):
    transcription = transcribe(declare())
    point = transcription.program.start * np.linspace(1.02, 1.1, transcription.places.size)
    exact = transcription.program.evaluate(point)

    def values(x):
        evaluation = transcription.program.evaluate(x)
        return np.append(evaluation.constraints, evaluation.objective)

    jacobian = np.vstack([exact.jacobian, exact.gradient])
    blocks = [*transcription.rows, slice(len(exact.constraints), None)]
    assert derivative_error(values, jacobian, point, blocks) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["Ipopt", "Slsqp"])
@pytest.mark.parametrize("name", ["dOpt", "uOpt", "aOpt"])
def test_the_solvers_agree_on_every_optimum(name, solver):
    other = optimum(PROBLEMS[name](), SOLVERS[solver])
    assert other.objective == pytest.approx(best(name).objective, rel=1e-5)


def test_the_robust_optimum_is_that_of_an_independent_program():
    # 185.3167 by CasADi's own single shooting, in design.md.
    assert best("uOpt").objective == pytest.approx(185.3167, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "active"),
    [("dOpt", {"holding"}), ("uOpt", {"travel"}), ("aOpt", {"travel", "ride"}), ("uOpt, narrow", {"travel"})],
)
def test_the_active_constraints_are_the_published_ones(name, active):
    assert {one.name for one in design(name).constraints if np.any(one.active)} == active
    assert "k_s.mean" in design(name).at_bounds
    certificate = design(name).certificate
    assert max(certificate.violation, certificate.stationarity, certificate.complementarity) < 1e-6


def test_the_deterministic_optimum_holds_in_an_independent_simulation():
    chosen = best("dOpt").decisions
    ride, holding, travel = quarter_car(376.0, chosen["k_s.mean"], chosen["b_s.mean"], 1.39, 200e3)
    assert best("dOpt").objective == pytest.approx(ride[0], rel=1e-9)
    assert holding[0] == pytest.approx(0.034, rel=1e-6)
    assert np.abs(travel).max() < 0.203


def published_cost(k_s, b_s, eta):
    return 0.5 + 1.40e6 / k_s**1.5 + 0.75 + 3.31e5 / b_s**2 + 0.85 + 0.733 / eta


@pytest.mark.slow
def test_apportionment_saves_what_the_chapter_says_and_more_with_more_travel():
    start = transcribe(apportionment_problem())
    initial = start.program.evaluate(start.program.start).objective
    assert initial == pytest.approx(published_cost(3750.0, 250.0, 0.17375), rel=1e-12)
    assert initial == pytest.approx(17.71, abs=0.005)
    spreads = (best("aOpt").decisions[f"{name}.half_width"] for name in ("k_s", "b_s", "eta"))
    assert best("aOpt").objective == pytest.approx(published_cost(*spreads), rel=1e-10)
    assert 1 - best("aOpt").objective / initial > 0.65
    wider = optimum(apportionment_problem(travel=0.25))
    assert wider.objective < best("aOpt").objective
