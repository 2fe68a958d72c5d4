"""`RandomProcess`: a Gaussian process as a signal, by the modes of its covariance."""

import functools
from typing import Any, ClassVar, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.border import one_of, positive, whole
from aleator._core.errors import ExpansionWarning, ProblemError, warn_outside
from aleator._core.leaves import lowest, stored_number
from aleator.trajectories import AbstractCovariance, AbstractSignal, common_span, karhunen_loeve, plain_number
from aleator.uncertainty._families import Normal

# Default share of the variance that is retained.
_ENERGY = 0.99
# A smaller retained share gives a warning.
_LITTLE = 0.9


@final
class RandomProcess(AbstractSignal):
    """A Gaussian process `mean(t) + std Σ_k sqrt(λ_k) φ_k(t) ξ_k` from `t_start` to `t_final`, in seconds.

    Sensor noise, actuator noise or forcing with known covariance `std² correlation(|t - s|)`: an uncertain function of
    time, expanded as in equations (11) and (19) of the dissertation. `λ_k`, `φ_k` are the eigenpairs of the correlation
    on the interval (Karhunen-Loève), and each mode adds one standard normal variable `ξ_k` to the germ:
    `inputs.wind.xi.0`, ... The cost of an expansion grows with their number, which `print` shows; a response that is
    linear in the noise needs only order 1.

    - `covariance`: `ExponentialCovariance`, `SquaredExponentialCovariance`, `BandLimitedCovariance` or your own class;
    - `std`: the standard deviation, a number, distribution or `Decision`, in the unit of the signal;
    - `mean`: a number, distribution, `Decision` or another signal;
    - `energy` or `modes`: retain as many modes as carry the share `energy` of the variance (default 0.99), or exactly
      `modes`. With `modes`, a change of the correlation time seldom causes recompilation.

    The truncation error is known: `share` is the fraction of the variance retained on average over time, and `deficit`
    the fraction missing at each instant. `validate` samples the truncated process too, so an `ExpansionWarning` is
    issued where the modes carry less than nine tenths of the variance.

    Raises `ProblemError` for impossible numbers, and for modes that the covariance does not have or that vary too fast
    to be resolved.
    """

    covariance: AbstractCovariance
    xi: tuple[Any, ...]
    std: Any
    mean: Any
    eigenvalues: Float[np.ndarray, " modes"]
    functions: Float[np.ndarray, "polynomials modes"]
    t_start: float
    t_final: float

    unbounded: ClassVar[bool] = True

    def __init__(
        self,
        covariance: AbstractCovariance,
        *,
        t_final: float,
        std: Any,
        mean: Any = 0.0,
        t_start: float = 0.0,
        energy: float | None = None,
        modes: int | None = None,
    ):
        example = "al.processes.ExponentialCovariance(0.5)"
        self.covariance = one_of("RandomProcess: covariance", covariance, AbstractCovariance, example)
        self.t_start = plain_number("RandomProcess: 't_start'", t_start)
        self.t_final = plain_number("RandomProcess: 't_final'", t_final)
        if not self.t_start < self.t_final:
            raise ProblemError(
                f"RandomProcess: t_final must be after t_start={t_start:g}; received t_final={t_final:g}."
            )
        self.std = stored_number("RandomProcess: 'std'", std)
        least = 0.0 if getattr(std, "is_uncertain", False) else lowest(self.std)
        if least is not None and least < 0:
            raise ProblemError(f"RandomProcess: 'std' must not be negative; received {least:g}.")
        self.mean = mean if isinstance(mean, AbstractSignal) else stored_number("RandomProcess: 'mean'", mean)
        if energy is not None and modes is not None:
            raise ProblemError(
                f"RandomProcess: expected energy or modes, not both; received energy={energy} and modes={modes}. Drop "
                "one."
            )
        share = positive(
            "RandomProcess: energy, the share of the variance to keep", _ENERGY if energy is None else energy, below=1.0
        )
        count = None if modes is None else whole("RandomProcess: modes", modes)
        duration = self.t_final - self.t_start
        retained = karhunen_loeve(covariance, duration, share, count)
        self.xi = (Normal(0.0, 1.0),) * len(retained.shares)
        self.eigenvalues = retained.shares * duration
        self.functions = retained.functions
        self.span()
        if self.share < _LITTLE:
            remedy = (
                "what they leave out is in no statistic, limit or sample. Ask for more modes, or a smoother covariance."
            )
            warn_outside(f"{self}: {remedy}", ExpansionWarning)

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, ""]:
        coefficients = jnp.asarray(self.functions) @ jnp.stack([jnp.asarray(xi, dtype=float) for xi in self.xi])
        mean = self.mean(t) if isinstance(self.mean, AbstractSignal) else self.mean
        return mean + self.std * (self._polynomials(t) @ coefficients)

    def _polynomials(self, t: Float[Array, ""]) -> Float[Array, " polynomials"]:
        x = (2 * t - self.t_start - self.t_final) / (self.t_final - self.t_start)
        return legendre(x, len(self.functions))

    @override
    def span(self) -> tuple[float, float]:
        own = (float(self.t_start), float(self.t_final))
        return common_span([own, self.mean.span()]) if isinstance(self.mean, AbstractSignal) else own

    @property
    def share(self) -> float:
        """The fraction of the variance in the retained modes, on average over time."""
        return float(np.sum(self.eigenvalues) / (self.t_final - self.t_start))

    def deficit(self, times: Float[Array, " instants"]) -> Float[Array, " instants"]:
        """The fraction of the variance `std²` missing at each instant; it is largest at the ends."""
        shapes = jax.vmap(self._polynomials)(jnp.asarray(times, dtype=float)) @ jnp.asarray(self.functions)
        return 1 - jnp.sum(shapes**2, axis=1)

    def __str__(self) -> str:
        return (
            f"RandomProcess of {self.covariance} from {float(self.t_start):g} to {float(self.t_final):g} s: "
            f"{len(self.xi)} modes, which are {len(self.xi)} germ variables, carry {100 * self.share:.4g}% of the "
            "variance"
        )


# Its own program, so that one that is called outside of others is compiled once for each size.
@functools.partial(jax.jit, static_argnames="size")
def legendre(x: Float[Array, ""], size: int) -> Float[Array, " size"]:
    """The Legendre polynomials of degree 0 to `size - 1` at `x`, by their recurrence; differentiable in `x`."""

    def step(carry: tuple[Array, Array], degree: Array) -> tuple[tuple[Array, Array], Array]:
        before, now = carry
        after = ((2 * degree + 1) * x * now - degree * before) / (degree + 1)
        return (now, after), now

    x = jnp.asarray(x, dtype=float)
    _, values = jax.lax.scan(step, (jnp.zeros_like(x), jnp.ones_like(x)), jnp.arange(size, dtype=float))
    return values
