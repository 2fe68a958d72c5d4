"""Where fresh simulations contradict what an expansion says, evidence sounds the alarm; where they agree, none."""

import warnings
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import aleator as al
from aleator.validation import Compared
from aleator.validation._batches import Sums
from aleator.validation._tally import reach, worst_disagreement
from zoo import algebraic

X, UNIFORM = al.output("x"), al.Uniform(0.0, half_width=1.0)
RESPONSES = {
    "smooth": lambda a, b: 2 * a + 0.2 * b * a,
    # Nothing but in one corner, which holds 2.5 % of all systems.
    "spike": lambda a, b: 2 * a + 120.0 * jnp.maximum(a - 0.9, 0.0) * jnp.maximum(b - 0.5, 0.0),
    "waves": lambda a, b: 2 * jnp.cos(10.0 * (1 + 0.1 * a)),
}


class Response(al.AlgebraicSystem):
    """A response of two uncertain numbers: which, is data."""

    gain: al.Number
    a: al.Number
    b: al.Number
    weights: Any

    def outputs(self):
        each = zip(self.weights, RESPONSES.values(), strict=True)
        x = sum(weight * response(self.a, self.b) for weight, response in each)
        return {"x": x, "gain": self.gain, "loss": (self.gain - 1.0) ** 2}


SPREAD, LEVEL, RARE = X.std <= 5.0, X.quantile(0.9) <= 5.0, X.probability(above=2.1) <= 0.9


def solved(kind, a=UNIFORM, b=UNIFORM, limits=(SPREAD, LEVEL, RARE), order=3, points=None, tolerance=10.0):
    """A design that nothing uncertain depends on; its expansion is trusted whatever it misses."""
    system = Response(al.Decision(0.5, 0.0, 2.0), a, b, [float(kind == one) for one in RESPONSES])
    problem = al.Problem(
        system,
        minimize=al.output("loss").mean,
        subject_to=[one.named(f"limit {i}") for i, one in enumerate(limits)],
        expansion=al.Expansion(order, points=points, tolerance=tolerance),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return al.solve(problem, throw=False)


def alarmed(solution, samples=20_000, **options):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        evidence = al.validate(solution, samples, **options)
    warned = any(issubclass(one.category, al.ExpansionWarning) for one in told)
    assert warned is not evidence.agrees
    return evidence


def test_what_agrees_sounds_no_alarm():
    """A probability is judged by its exact interval, so that a rare event may not occur at all."""
    smooth = solved("smooth")
    for samples, seed in ((300, 0), (20_000, 1)):
        evidence = alarmed(smooth, samples, seed=seed)
        assert evidence.agrees
        assert all(one.meets for one in evidence.compared)


def test_a_spike_in_a_corner_without_points_is_found_and_breaks_the_limit_on_a_spread(tmp_path):
    solution = solved("spike", limits=(X.std <= 1.17, LEVEL, RARE))
    assert solution.certificate.expansion.unseen is not None
    evidence = alarmed(solution)
    assert not evidence.agrees
    told = {one.text: one for one in evidence.disagreements}
    # By integration: of 120 (a - 0.9)+ (b - 0.5)+.
    extra = 120 * (0.1**2 / 4) * (0.5**2 / 4)
    assert told["σ[x]"].estimate > 1.02 * told["σ[x]"].expected
    sampled = evidence.functionals["x"]
    assert abs(float(sampled.mean) - extra) < 5 * float(sampled.standard_error)
    assert evidence.compared[0].meets is False
    assert "BROKEN" in str(evidence)
    page = al.report(solution, evidence, path=tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Contradicted" in page


def test_limits_on_statistics_are_compared_with_their_bounds():
    std = 2 / np.sqrt(3)
    end, width = al.output("gain").mean.equals(1.0), X.quantile(0.75) - X.quantile(0.25)
    cost = al.cost.reciprocal("gain", bias=0.0, scale=1.0) + X.std <= 9.0
    limits = X.std <= 1.2 * std, X.std <= std, end, width <= 2.0 + 1e-9, cost
    plain = solved("smooth", b=al.Uniform(0.0, half_width=1e-9), limits=limits, tolerance=0.05)
    evidence = al.validate(plain, 20_000)
    found = {one.name: one for one in evidence.compared}
    assert found["limit 0"].meets is True
    assert found["limit 1"].meets is None
    assert found["limit 2"].meets is not False
    assert found["limit 3"].meets is None
    assert found["limit 4"].value == pytest.approx(1.0 + found["limit 0"].value)
    # The standard error of a sampled std of a uniform distribution, whose kurtosis is 1.8.
    assert found["limit 1"].standard_error == pytest.approx(std * np.sqrt(0.8 / 4 / 20_000), rel=0.4)
    assert "within its error of the bound" in str(evidence)


# --- Comparisons -----------------------------------------------------------------------------------------------------


def test_the_worst_instant_of_a_path_is_compared_with_a_correction_for_their_number():
    generator = np.random.default_rng(0)
    # Under agreement: of 500 instants the worst is beyond four standard errors now and then, and never an alarm.
    error, beyond = np.full(500, 0.1), 0
    given = {"samples": 100, "freedom": 10_000, "times": np.arange(500.0)}
    for _ in range(200):
        estimate = generator.normal(0.0, 0.1, 500)
        beyond += np.max(np.abs(estimate)) > 0.4
        assert worst_disagreement("x(t)", np.zeros(500), estimate, error, **given) is None
    assert beyond > 0
    estimate[7] += 1.0
    assert worst_disagreement("x(t)", np.zeros(500), estimate, error, **given).time == 7.0


def test_over_time_a_disagreement_counts_beside_the_largest_spread():
    # A spread that starts from nothing: what an instant before misses is small beside what comes.
    spread = np.array([0.0, 1e-6, 1e-3, 0.3, 1.0])
    given = {"samples": 1000, "freedom": 1000, "times": np.arange(5.0)}
    numbers = "σ[x(t)]", np.array([0.0, 0.0, 1e-3, 0.3, 1.0]), spread, spread / np.sqrt(2000)
    assert worst_disagreement(*numbers, **given) is not None
    assert worst_disagreement(*numbers, floor=0.01, **given) is None
    off = "σ[x(t)]", np.array([0.0, 0.0, 1e-3, 0.27, 1.0]), *numbers[2:]
    told = worst_disagreement(*off, floor=0.01, **given)
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


@pytest.mark.parametrize(
    ("beyond", "error", "meets"), [(-0.5, 0.01, True), (0.5, 0.01, False), (0.01, 0.01, None), (np.nan, np.nan, False)]
)
def test_a_comparison_meets_its_limit_breaks_it_or_cannot_tell(beyond, error, meets):
    one = Compared("stress", "mean ≤ 1", 1.0 + beyond, error, None, 1.0, beyond, tolerance=1e-6, reach=4.0)
    assert one.meets is meets


@pytest.mark.parametrize(
    ("expected", "estimate", "error", "agrees"),
    [(np.nan, 1.0, 0.1, False), (1.0, np.nan, 0.1, False), (1.0, np.inf, np.inf, False), (1.0, 2.0, np.nan, True)],
)
def test_what_is_no_number_disagrees_and_without_a_standard_error_there_is_no_verdict(
    expected, estimate, error, agrees
):
    numbers = (np.asarray(one) for one in (expected, estimate, error))
    assert (worst_disagreement("x", *numbers, samples=100, freedom=99) is None) is agrees


@algebraic
def gap(hole, shaft):
    return {"gap": hole - shaft}


def test_tails_beyond_the_zones_of_parts_do_not_contradict_their_worst_case():
    hole, shaft = al.Toleranced(al.Decision(5.0, 4.0, 6.0), tolerance=0.3), al.Toleranced(4.5, tolerance=0.1)
    limit = al.output("gap").at_least(0.05, worst_case=True)
    problem = al.Problem(gap(hole, shaft), minimize=al.output("gap").mean, subject_to=[limit])
    solution = al.solve(problem)
    evidence = al.validate(solution, 20_000)
    assert evidence.violations["gap"].count > 0
    assert evidence.agrees
    # A hole that is smaller than the design's is beyond them in more systems than have a part outside of its zone.
    moved = replace(solution, decisions={"hole.nominal": 4.8}, vector=np.array([4.8]))
    with pytest.warns(al.ExpansionWarning, match="as by the zones of its numbers"):
        al.validate(moved, 20_000)
