"""Signals with numbers of a model in them: random processes, functions of time and parameters, and sums."""

import warnings
from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.border import real, real_array, refusal
from aleator._core.errors import ExpansionWarning, ProblemError
from aleator._core.leaves import AbstractLeaf, realised_shape
from aleator.processes._covariance import (
    AbstractCovariance,
    karhunen_loeve,
    legendre,
    plain_number,
)
from aleator.trajectories import AbstractSignal
from aleator.uncertainty import Decision, Normal

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
        if not isinstance(covariance, AbstractCovariance):
            raise ProblemError(
                "RandomProcess: expected a covariance, such as al.processes.ExponentialCovariance(0.5); "
                f"received {type(covariance).__name__} {covariance!r}."
            )
        self.covariance = covariance
        self.t_start, self.t_final = _interval(t_start, t_final)
        self.std = _spread(std)
        self.mean = mean if isinstance(mean, AbstractSignal) else _number("mean", mean)
        _check_size(energy, modes)
        duration = self.t_final - self.t_start
        retained = karhunen_loeve(covariance, duration, _ENERGY if energy is None else float(energy), modes)
        self.xi = (Normal(0.0, 1.0),) * len(retained.shares)
        self.eigenvalues = retained.shares * duration
        self.functions = retained.functions
        self.span()
        if self.share < _LITTLE:
            remedy = (
                "what they leave out is in no statistic, limit or sample. Ask for more modes, or a smoother covariance."
            )
            warnings.warn(f"{self}: {remedy}", ExpansionWarning, stacklevel=3)

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


def _interval(t_start: float, t_final: float) -> tuple[float, float]:
    start, end = (plain_number("RandomProcess", name, t) for name, t in (("t_start", t_start), ("t_final", t_final)))
    if not start < end:
        raise ProblemError(f"RandomProcess: t_final must be after t_start={start:g}; received t_final={end:g}.")
    return start, end


def _number(name: str, value: Any) -> Any:
    """One number of a model: plain, uncertain, decided or traced by JAX. Raises `ProblemError` for anything else."""
    if isinstance(value, AbstractLeaf | jax.Array) and realised_shape(value) == ():
        return value
    return real(f"RandomProcess: '{name}'", value, "one number, one distribution or one Decision")


def _spread(std: Any) -> Any:
    std = _number("std", std)
    lowest = std if isinstance(std, float) else float(std.lower) if isinstance(std, Decision) else 0.0
    if lowest < 0:
        raise ProblemError(f"RandomProcess: 'std' must not be negative; received {lowest:g}.")
    return std


def _check_size(energy: float | None, modes: int | None) -> None:
    if energy is not None and modes is not None:
        raise ProblemError(
            f"RandomProcess: expected energy or modes, not both; received energy={energy} and modes={modes}. Drop one."
        )
    if energy is not None and not 0 < plain_number("RandomProcess", "energy", energy) < 1:
        raise ProblemError(
            f"RandomProcess: energy is the share of the variance to keep, between 0 and 1; received {energy:g}."
        )
    if modes is not None and (isinstance(modes, bool) or not isinstance(modes, int | np.integer) or modes < 1):
        raise ProblemError(f"RandomProcess: modes is a whole number of at least 1; received {modes!r}.")


@final
class Parametrised(AbstractSignal):
    """A function of time and parameters; see `signal`. A parameter's name is its place: `inputs.force.p.amplitude`."""

    function: Callable[[Any, Any], Any] = eqx.field(static=True)
    p: dict[str, Any]

    def __init__(self, function: Callable[[Any, Any], Any], parameters: dict[str, Any]):
        if not callable(function):
            raise ProblemError(
                "signal: expected a function of time and parameters, such as lambda t, p: p.rate * t; "
                f"received {type(function).__name__} {function!r}."
            )
        self.function = function
        self.p = {name: _parameter(name, value) for name, value in parameters.items()}

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        return jnp.asarray(self.function(t, SimpleNamespace(**self.p)), dtype=float)

    @override
    def span(self) -> tuple[float, float]:
        return -np.inf, np.inf


def signal(function: Callable[[Any, Any], Any], /, **parameters: Any) -> Parametrised:
    """The signal `function(t, p)`, where each parameter is an attribute of `p`.

    A parameter is a number or an array, a distribution, a `Decision` or another signal: `signal(lambda t, p:
    p.amplitude * jnp.sin(p.frequency * t), amplitude=Normal(1.0, 0.1),
    frequency=3.0)`. The function is written with `jax.numpy`, for one instant `t` in seconds.  Uncertain coefficients
    of given functions of time also make a random process; `RandomProcess` makes one from its covariance.

    The function is part of a problem's structure: define it once and reuse it, and it is compiled once.

    Raises `ProblemError` if `function` is not a function, or for a parameter of any other kind.
    """
    return Parametrised(function, parameters)


def _parameter(name: str, value: Any) -> Any:
    """A parameter as it is stored: floats are data, which never cause recompilation; integers are structure."""
    is_structure = isinstance(value, int) and not isinstance(value, bool)
    if is_structure or isinstance(value, AbstractLeaf | AbstractSignal | jax.Array):
        return value
    numbers = real_array(f"signal: parameter '{name}'", value, "finite numbers, a distribution, a Decision or a signal")
    if not np.isfinite(numbers).all():
        raise refusal(f"signal: parameter '{name}'", "finite numbers", value)
    return float(numbers) if numbers.ndim == 0 else numbers


@final
class Total(AbstractSignal):
    """The sum of signals; see `total`. Its numbers are named after their signal's place: `inputs.force.parts.0...`."""

    parts: tuple[AbstractSignal, ...]

    def __init__(self, parts: Iterable[AbstractSignal]):
        self.parts = tuple(parts)
        for part in self.parts:
            if not isinstance(part, AbstractSignal):
                raise ProblemError(
                    "total: expected signals, such as al.processes.total(command, noise); received "
                    f"{type(part).__name__} {part!r}. Make a constant or a function of time a signal with "
                    "al.processes.signal."
                )
        if not self.parts:
            raise ProblemError("total: expected at least one signal; received none.")
        self.span()

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        first, *others = (part(t) for part in self.parts)
        return sum(others, start=first)

    @override
    def over(self, t_start: Any, t_final: Any) -> "Total":
        def is_part(node: Any) -> bool:
            return isinstance(node, AbstractSignal) and node is not self

        # They were checked, and may be traced.
        return jax.tree.map(lambda part: part.over(t_start, t_final), self, is_leaf=is_part)

    @override
    def sampled(self, fractions: Float[np.ndarray | Array, " n"], t_start: Any, t_final: Any) -> Float[Array, "n ..."]:
        first, *others = (part.sampled(fractions, t_start, t_final) for part in self.parts)
        return sum(others, start=first)

    @override
    def span(self) -> tuple[float, float]:
        return common_span(part.span() for part in self.parts)


def total(*signals: AbstractSignal) -> Total:
    """The sum of signals: a command and the actuator's noise, a mean road and its roughness.

    Raises `ProblemError` for arguments that are not signals, and for signals with no common time.
    """
    return Total(signals)


def common_span(spans: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """The times that lie in all spans. Raises `ProblemError` if there are none."""
    spans = tuple(spans)
    first, last = max(start for start, _ in spans), min(end for _, end in spans)
    if not first < last:
        known = " and ".join(f"from {start:g} to {end:g} s" for start, end in spans)
        raise ProblemError(f"Signals that are added must be known at the same times; received signals known {known}.")
    return first, last
