"""Random processes and parametrised signals in simulations and problems, against closed forms."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator._core.arrays import numbers_to_arrays
from aleator.dynamics import simulate
from aleator.uncertainty import at_means, named_numbers, placements, realise
from compiling import compiled

# Few modes, on purpose: what they leave out is what these tests ask about.
pytestmark = pytest.mark.filterwarnings("ignore:RandomProcess:aleator.ExpansionWarning")

T = 2.0
SMOOTH = al.processes.SquaredExponentialCovariance(0.4)


class Lag(al.System):
    """`x' = u - rate x` from rest."""

    states = ("x",)
    rate: Any = 1.5

    def rhs(self, t, z, u):
        return (u - self.rate * z.x,)

    def outputs(self, t, z, u):
        return {"x": z.x, "u": u}


def process(covariance: al.processes.AbstractCovariance = SMOOTH, **options: Any) -> al.processes.RandomProcess:
    return al.processes.RandomProcess(covariance, **({"t_final": T, "std": 0.3} | options))


def responses(signal: Any, steps: int) -> np.ndarray:
    """The response of a lag at the final time to each coefficient alone, one standard deviation each, by `simulate`."""

    def final(germ):
        realised = realise({"signal": signal}, germ, jnp.zeros(0))["signal"]
        return simulate(Lag(), al.Grid(T, steps), {"u": realised})["x"][-1]

    return np.asarray(compiled(jax.vmap(final))(np.eye(len(signal.xi))))


def lag_variance(rate: float, correlation_time: float) -> float:
    """`∫∫ exp(-a (x + y)) exp(-|x - y| / correlation_time) dx dy` on [0, T]²."""
    a, b = rate, 1 / correlation_time
    return 2 / (b - a) * ((1 - np.exp(-2 * a * T)) / (2 * a) - (1 - np.exp(-(a + b) * T)) / (a + b))


def test_the_response_of_a_lag_to_exponential_noise_has_the_variance_of_the_closed_form():
    covariance = al.processes.ExponentialCovariance(0.5)
    variance = np.sum(responses(process(covariance, modes=20), 400) ** 2)
    # The modes left out act through the impulse response h: at most by the next eigenvalue times ∫ h².
    following = process(covariance, modes=21).eigenvalues[-1]
    missing = 0.3**2 * lag_variance(1.5, 0.5) - variance
    assert -1e-9 < missing < 0.3**2 * following * (1 - np.exp(-3.0 * T)) / 3.0


def test_mean_and_std_may_be_uncertain_or_decided():
    noise = process(mean=al.Uniform(5.0, half_width=1.0), std=al.Decision(0.3, 0.0, 1.0), modes=2)
    model = numbers_to_arrays({"u": noise})
    places = placements(model)
    assert places.germ_names == ("u.xi.0", "u.xi.1", "u.mean")
    assert places.entry_names() == ("u.std",)

    @compiled
    def values(germs, at):
        held = realise(at_means(model), np.zeros(0), np.ones(1))["u"]
        return jax.vmap(lambda germ: realise(model, germ, np.ones(1))["u"](at))(germs), held(at), noise.deficit([0.5])

    found, held, deficit = values(np.array([[0.0, 0.0, 0.5], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), 0.5)
    assert float(found[0]) == 5.5
    assert np.sum((np.asarray(found)[1:] - 5.0) ** 2) == pytest.approx(1 - float(deficit[0]), abs=1e-12)
    assert float(held) == 5.0


def test_a_process_knows_no_more_times_than_its_mean():
    mean = al.Tabulated([0.5, 3.0], [0.0, 1.0])
    assert process(mean=mean, modes=2).span() == (0.5, T)
    with pytest.raises(al.ProblemError, match=r"known from 0 to 2 s and from 2\.5 to 3 s"):
        process(mean=al.Tabulated([2.5, 3.0], [0.0, 1.0]), modes=2)


def test_parameters_of_a_signal_may_be_of_any_kind_and_are_called_by_their_names():
    wave = al.processes.signal(
        lambda t, p: p.amplitude * jnp.sin(p.frequency * t) + p.offset(t) + sum(p.c[i] * t**i for i in range(p.terms)),
        amplitude=al.Normal(2.0, 0.1),
        frequency=al.Decision(3.0, 1.0, 5.0),
        offset=al.Tabulated([0.0, 4.0], [1.0, 1.0]),
        c=np.array([1.0, 0.5]),
        terms=2,
    )
    model = {"inputs": {"force": wave}}
    assert placements(model).germ_names == ("inputs.force.p.amplitude",)
    assert placements(model).entry_names() == ("inputs.force.p.frequency",)
    assert set(named_numbers(model, jnp.array([3.0]))) >= {"inputs.force.p.c", "inputs.force.p.amplitude.std"}
    realised = realise(model, jnp.array([1.5]), jnp.array([4.0]))["inputs"]["force"]
    assert realised.sampled(np.array([0.075]), 0.0, 4.0) == pytest.approx(2.15 * np.sin(1.2) + 2.15, rel=1e-14)
    assert wave.span() == (-np.inf, np.inf)


def test_signals_add_up_and_keep_their_uncertain_numbers():
    command = al.processes.signal(lambda t, p: p.rate * t, rate=al.Normal(2.0, 0.1))
    both = al.processes.total(command, al.Tabulated([0.5, 3.0], [1.0, 1.0]), process(mean=0.5, modes=2))
    model = {"u": both}
    assert placements(model).germ_names == ("u.parts.0.p.rate", "u.parts.2.xi.0", "u.parts.2.xi.1")
    assert both.span() == (0.5, T)
    at = realise(model, jnp.array([1.0, 0.0, 0.0]), jnp.zeros(0))["u"]
    assert at.sampled(np.array([1.0 / T]), 0.0, T) == pytest.approx(2.1 + 1.0 + 0.5, rel=1e-14)


def test_a_trajectory_inside_a_signal_fills_the_time_grid():
    rising, ends = al.BSpline(np.linspace(0.0, 1.0, 5)), np.array([0.0, 0.5, 1.0])
    twice = al.processes.signal(lambda t, p: 2 * p.path(t), path=rising)
    inputs = {"around": process(mean=rising, modes=2), "twice": twice}

    @compiled
    def sampled():
        realised = realise(inputs, jnp.zeros(2), jnp.zeros(0))
        return [realised[name].sampled(ends, 0.0, T) for name in inputs]

    np.testing.assert_allclose(sampled(), [ends, 2 * ends], atol=1e-14)


class Falling(al.processes.AbstractCovariance):
    """No covariance: its spectrum is negative in places."""

    def correlation(self, lag):
        return 1 - (lag / T) ** 2


from_psd = al.processes.BandLimitedCovariance.from_psd
REFUSED = [
    (lambda: al.processes.ExponentialCovariance(al.Normal(0.5, 0.1)), "computed once; expected a plain number"),
    (lambda: from_psd([0, 2, 1], [1, 1, 1]), "increase from 0 Hz"),
    (lambda: process(t_start=3.0), "t_final must be after t_start=3; received t_final=2"),
    (lambda: process(energy=0.9, modes=3), r"received energy=0\.9 and modes=3\. Drop one"),
    (lambda: process(modes=60), r"60 modes were asked for, but only \d+ carry more than 1e-12"),
    (lambda: process(Falling(), modes=2), "is not a covariance: its eigenvalue -.* is negative"),
    (lambda: al.processes.total(al.Tabulated([0, 1], [0, 1]), al.Tabulated([2, 3], [0, 1])), "known at the same times"),
]


def test_input_that_makes_no_process_or_signal_is_refused():
    for make, message in REFUSED:
        with pytest.raises(al.ProblemError, match=message):
            make()
