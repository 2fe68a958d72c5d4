"""Where fresh simulations contradict what an expansion says, evidence sounds the alarm; where they agree, none."""

import warnings
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import aleator as al
from aleator.validation._disagreement import reach, worst_disagreement
from aleator.validation._sums import Sums
from tiny_models import LOSS, ONE_STEP, RESPONSE, gain_problem

X = al.terminal("x")


class Response(al.System):
    """No dynamics: a response of two uncertain numbers, one of them named by `kind`."""

    states = ("nothing",)
    gain: Any
    a: Any
    b: Any
    kind: str = "smooth"

    def rhs(self, t, z):
        return (0.0 * z.nothing,)

    def outputs(self, t, z):
        responses = {
            "smooth": self.a + 0.1 * self.b * self.a,
            # Nothing but in one corner, which holds 2.5 % of all systems.
            "spike": self.a + 60.0 * jnp.maximum(self.a - 0.9, 0.0) * jnp.maximum(self.b - 0.5, 0.0),
            # Nothing but on a hill inside, flat around it, which holds 1.6 % of all systems.
            "hill": 100.0 * jnp.maximum(0.02 - (self.a - 0.41) ** 2 - (self.b + 0.37) ** 2, 0.0),
            "waves": jnp.cos(10.0 * (1 + 0.1 * self.a)),
        }
        return {"x": responses[self.kind] * (1 + t), "gain": self.gain, "loss": (self.gain - 1.0) ** 2}


def solved(kind, a, b, *limits, order=3, points=None, tolerance=10.0, objective=X.mean):
    """A design at the bound of a decision that nothing depends on; its expansion is trusted whatever it misses."""
    system = Response(al.Decision(0.5, 0.0, 2.0), a, b, kind)
    return al.solve(
        al.Problem(
            system,
            grid=ONE_STEP,
            minimize=al.terminal("loss").mean + 0.0 * objective,
            subject_to=[one.named(f"limit {i}") for i, one in enumerate(limits)],
            expansion=al.Expansion(order, points=points, tolerance=tolerance),
        ),
        throw=False,
    )


UNIFORM = al.Uniform(0.0, half_width=1.0)


def alarmed(solution, samples=20_000, **options):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        evidence = al.validate(solution, samples, **options)
    warned = any(issubclass(one.category, al.ExpansionWarning) for one in told)
    assert warned is not evidence.agrees
    return evidence


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_what_agrees_sounds_no_alarm(seed):
    limits = X.std <= 5.0, X.quantile(0.9) <= 5.0, X.probability(above=1.0) <= 0.9, al.path("x").std <= 3.0
    evidence = alarmed(solved("smooth", UNIFORM, UNIFORM, *limits), 4_000, seed=seed)
    assert evidence.agrees
    assert all(one.meets for one in evidence.compared)


def test_a_spike_in_a_corner_without_points_is_found():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solution = solved("spike", UNIFORM, UNIFORM)
    assert solution.certificate.expansion.unseen is not None
    evidence = alarmed(solution)
    assert not evidence.agrees
    assert str(evidence).startswith("DISAGREES: fresh simulations contradict the solution:")
    told = {one.text: one for one in evidence.disagreements}
    # By integration: of 60 (a - 0.9)+ (b - 0.5)+ and its square, at t = 1.
    extra = 2 * 60 * (0.1**2 / 4) * (0.5**2 / 4)
    assert told["σ[x(t_f)]"].estimate > 1.02 * told["σ[x(t_f)]"].expected
    sampled = evidence.functionals["x(t_f)"]
    assert abs(float(sampled.mean) - extra) < 5 * float(sampled.standard_error)


def test_waves_that_an_order_misses_are_found_with_their_closed_form():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solution = solved("waves", al.Normal(0.0, 1.0), UNIFORM, points=al.points.HammersleyPoints())
    evidence = alarmed(solution)
    first = np.cos(10) * np.exp(-0.5)
    variance = 4 * ((1 + np.cos(20) * np.exp(-2.0)) / 2 - first**2)
    (told,) = (one for one in evidence.disagreements if one.text == "σ[x(t_f)]")
    assert told.estimate == pytest.approx(np.sqrt(variance), rel=0.03)
    assert abs(told.expected - np.sqrt(variance)) > 0.03 * np.sqrt(variance)


def test_limits_on_statistics_are_compared_with_their_bounds():
    std = 2 / np.sqrt(3)
    end, width = al.terminal("gain").mean.equals(1.0), X.quantile(0.75) - X.quantile(0.25)
    limits = X.std <= 1.2 * std, X.std <= std, end, width <= 2.0 + 1e-9
    plain = Response(al.Decision(0.5, 0.0, 2.0), UNIFORM, al.Uniform(0.0, half_width=1e-9))
    solution = al.solve(
        al.Problem(
            plain,
            grid=ONE_STEP,
            minimize=al.terminal("loss").mean,
            subject_to=[one.named(f"limit {i}") for i, one in enumerate(limits)],
        )
    )
    evidence = al.validate(solution, 10_000)
    found = {one.name: one for one in evidence.compared}
    assert found["limit 0"].meets is True
    assert found["limit 1"].meets is None
    assert found["limit 2"].meets is not False
    assert found["limit 3"].meets is None
    # The standard error of a sampled std of a uniform distribution, whose kurtosis is 1.8.
    assert found["limit 1"].standard_error == pytest.approx(std * np.sqrt(0.8 / 4 / 10_000), rel=0.4)
    assert "within its error of the bound" in str(evidence)


def test_a_limit_on_a_spread_that_the_samples_break_is_an_alarm():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solution = solved("spike", UNIFORM, UNIFORM, X.std <= 1.17, objective=X.std)
    evidence = alarmed(solution, 60_000)
    assert evidence.compared[0].meets is False
    assert any("its bound" in one.sentence() for one in evidence.disagreements)
    assert "BROKEN" in str(evidence)


def test_any_system_beyond_a_limit_for_all_systems_is_an_alarm():
    # Flat around the hill: no corner is on it, and no search by slopes finds it.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solution = solved("hill", UNIFORM, UNIFORM, X.at_most(2.6, worst_case=True))
    evidence = alarmed(solution)
    assert evidence.violations["limit 0"].count > 0
    assert any("The share of systems that break 'limit 0'" in one.text for one in evidence.disagreements)


def test_the_worst_instant_of_a_path_is_compared_with_a_correction_for_their_number():
    generator = np.random.default_rng(0)
    # Under agreement: of 500 instants the worst is beyond four standard errors now and then, and never an alarm.
    alarms, beyond = 0, 0
    for _ in range(200):
        error = np.full(500, 0.1)
        estimate = generator.normal(0.0, 0.1, 500)
        beyond += np.max(np.abs(estimate)) > 0.4
        told = worst_disagreement("x(t)", np.zeros(500), estimate, error, samples=100, freedom=10_000)
        alarms += told is not None
    assert alarms == 0
    assert beyond > 0
    estimate[7] += 1.0
    told = worst_disagreement(
        "x(t)", np.zeros(500), estimate, error, samples=100, freedom=10_000, times=np.arange(500.0)
    )
    assert told is not None
    assert told.time == 7.0


def test_over_time_a_disagreement_counts_beside_the_largest_spread():
    # A spread that starts from nothing: what an instant before misses is small beside what comes.
    spread = np.array([0.0, 1e-6, 1e-3, 0.3, 1.0])
    given = {"samples": 1000, "freedom": 1000, "times": np.arange(5.0)}
    numbers = "σ[x(t)]", np.array([0.0, 0.0, 1e-3, 0.3, 1.0]), spread, spread / np.sqrt(2000)
    assert worst_disagreement(*numbers, **given) is not None
    assert worst_disagreement(*numbers, spread=1.0, **given) is None
    off = "σ[x(t)]", np.array([0.0, 0.0, 1e-3, 0.27, 1.0]), *numbers[2:]
    told = worst_disagreement(*off, spread=1.0, **given)
    assert told is not None
    assert told.time == 3.0


def test_four_standard_errors_of_a_large_sample_are_the_reach_of_one_comparison():
    assert reach(10**7) == pytest.approx(4.0, rel=1e-5)
    assert stats.t.sf(reach(31, 10), 31) == pytest.approx(stats.norm.sf(4.0) / 10, rel=1e-8)


def test_moments_that_are_merged_are_those_of_all_samples_together():
    values = np.random.default_rng(3).gamma(2.0, 1.0, (700, 3))
    merged = Sums.of(values[:100]).merged(Sums.of(values[100:430])).merged(Sums.of(values[430:]))
    away = values - values.mean(axis=0)
    for part, power in ((merged.second, 2), (merged.third, 3), (merged.fourth, 4)):
        np.testing.assert_allclose(part, np.sum(away**power, axis=0), rtol=1e-11)
    # The spread of sampled standard deviations over fresh samples, by SciPy's bootstrap.
    found = stats.bootstrap((values[:, 0],), lambda x, axis: np.std(x, axis=axis, ddof=1), n_resamples=2000, rng=1)
    assert merged.std_error[0] == pytest.approx(found.standard_error, rel=0.15)


def test_a_deterministic_design_is_not_accused_of_an_expansion_it_does_not_have():
    nominal = al.solve(al.deterministic(gain_problem(upper=2.0, sigmas=1.0)))
    assert al.validate(nominal, 4000).agrees


def test_a_page_of_contradicted_evidence_says_so(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solution = solved("spike", UNIFORM, UNIFORM)
    page = al.report(solution, alarmed(solution), path=tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Contradicted" in page
    assert "samples and solution disagree" in page


def test_a_probability_that_agrees_is_judged_by_its_exact_interval():
    limit = al.Constraint(RESPONSE.probability(above=3.899), upper=0.5, name="rare")
    solution = al.solve(al.Problem(gain_problem().system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=[limit]))
    for seed in range(5):
        assert al.validate(solution, 300, seed=seed).agrees


@pytest.mark.parametrize("order", [1, 3])
def test_the_distribution_of_data_is_one_distribution_in_expansions_and_in_evidence(order):
    data = np.array([1.02, 0.97, 1.05, 0.99, 1.01])
    solution = solved("smooth", al.Sample(data), al.Uniform(0.0, half_width=1e-3), order=order)
    evidence = alarmed(solution)
    assert evidence.agrees
    assert evidence.functionals["x(t_f)"].std == pytest.approx(2 * data.std(), rel=0.02)


def test_what_is_certain_differs_by_the_error_of_its_grid_and_that_is_no_alarm():
    class Pushed(al.System):
        """Only the mass is uncertain, and the work of the push knows nothing of it."""

        states = ("x", "v")
        mass: Any

        def rhs(self, t, z, u):
            return z.v, u / self.mass

        def outputs(self, t, z, u):
            return {"x": z.x, "u2": jnp.sin(9 * t) * u**2}

    problem = al.Problem(
        Pushed(al.Uniform(1.0, half_width=0.05)),
        grid=al.Grid(1.0, 12),
        inputs={"u": al.BSpline(al.Decision(np.ones(4), -20.0, 20.0))},
        minimize=al.integral("u2").mean,
        subject_to=[al.terminal("x").mean.equals(1.0)],
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solution = al.solve(problem, throw=False)
    assert solution.certificate.grid_error.functionals["∫u2 dt"].error > 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert al.validate(solution, 500).agrees
