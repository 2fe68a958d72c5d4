"""`AbstractExpanded`: the statistics of an expanded function of uncertain inputs, and its text.

The text shows the uncertain inputs, the moments of each output, its main contributors and its error.
"""

import abc
import math
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax
import numpy as np
import scipy
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Pytree, in_library, jax_array
from aleator._core.border import real
from aleator._core.compilation import Use, evaluate
from aleator._core.errors import ExpansionWarning, ProblemError
from aleator._core.leaves import Drawn, Module, is_traced
from aleator.ensemble import at_levels, concrete, part, random_levels
from aleator.expansion import AbstractBasis, Collocation, left_out
from aleator.statistics import (
    AbstractMeasured,
    AbstractStatistic,
    AbstractTail,
    CornishFisher,
    Correlation,
    Covariance,
    Kurtosis,
    Probability,
    Skewness,
    Sobol,
    Std,
    a_statistic,
    cdf,
    lines_through,
    pdf,
)
from aleator.uncertainty import AbstractDistribution, AbstractGerm, refuse_correlated

# Germ values of unbounded distributions are sought between these probability levels, and further up, where a level is
# 1 but for rounding, to this value.
_FURTHEST_LEVELS, _FURTHEST = (1e-300, 1 - 1e-16), 600

_CONTRIBUTORS = 4
_LEAST_SHARE = 0.001
# The error of an integral that is told: as a part of a probability or of a spread. Probabilities below the second
# number are those of no tail.
_INTEGRATED, _NO_TAIL = 0.1, 1e-12
# Statistics of so few numbers take less time than a program that is any faster.
_FEW = 16
# Points that are left out at most, those that change most; the products of coefficients that these may take in all.
_MOST_LEFT_OUT, _PRODUCTS = 64, 10**8
# The change that is told, as a part of the statistic, of one at least, or of a spread. An entry of a path varies if its
# spread is more than this part of the largest.
_TOLD, _NEGLIGIBLE = 0.1, 1e-6
# A spread below this part of the mean is rounding.
_ROUNDING = 1e-14


@lru_cache(maxsize=64)
def prepared(preparation: Callable[[AbstractBasis], Pytree] | None, basis: AbstractBasis) -> Pytree:
    """The constants that a statistic needs of a basis: prepared on first use, and kept for the next."""
    # Kept values must not belong to a function that is being traced.
    with jax.ensure_compile_time_eval():
        return () if preparation is None else preparation(basis)


class AbstractExpanded(Module, Drawn, AbstractMeasured[Pytree]):
    """An uncertain output, or a dict of them, as polynomials of the uncertain inputs.

    Every statistic has the structure of the outputs: an array, entry by entry, or a dict; `expanded["y"]` selects one
    output of a dict. All are JAX functions of the distributions' parameters: apply `jax.grad` to a function that builds
    the distributions, expands and takes a statistic.
    """

    distributions: eqx.AbstractVar[dict[str, AbstractDistribution]]

    basis: eqx.AbstractVar[AbstractBasis]
    coefficients: eqx.AbstractVar[Pytree]

    @property
    def germs(self) -> Mapping[str, AbstractGerm]:
        """The distribution of each germ variable by name, in the order of a germ vector."""
        return self.basis.germs

    @override
    def statistic(self, kind: AbstractStatistic) -> Pytree:
        """Any other statistic of each output. Raises `ProblemError` for Sobol indices of correlated inputs."""
        refuse_correlated(self.distributions, kind.variables if isinstance(kind, Sobol) else ())
        constants = prepared(a_statistic(kind).preparation, self.basis)
        outputs, structure = jax.tree.flatten(self.coefficients)
        collocation, samples = self._known()
        values = []
        for terms, known in zip(outputs, samples, strict=True):
            without = with_points_left_out(kind, collocation, known, terms, constants)
            arguments = kind, constants, terms if without is None else jax_array(without)
            if kind.needs_no_compiler and not is_traced(arguments):
                value, error = _statistic_of(*arguments)
            else:
                value, error = evaluate(_statistic_of, *arguments, use=_use(terms))
            if error is not None and not is_traced(error):
                _warn_of_integral(kind, np.asarray(value), np.asarray(error), np.asarray(Std().of(terms, ())))
            if without is not None:
                warn_of_shape(kind, np.asarray(value), without[:, 0])
                value = jax_array(np.asarray(value)[0])
            values.append(value)
        return jax.tree.unflatten(structure, values)

    def _known(self) -> tuple[Collocation | None, list[Any]]:
        """The collocation, and the samples of each output there, where these are known."""
        return None, [None] * len(jax.tree.leaves(self.coefficients))

    @abc.abstractmethod
    def __getitem__(self, name: str) -> "AbstractExpanded":
        """One output by name, if the outputs are a dict."""

    def at_germ(self, points: Float[np.ndarray, "n variables"]) -> Pytree:
        """The expansion at germ points given as plain numbers: shape (n, *shape) for each output."""
        checked = checked_points(points, self.germs)
        return jax.tree.map(lambda terms: self.basis.values(checked, terms), self.coefficients)

    def sample(self, count: int, seed: int) -> Pytree:
        """The expansion at `count` random germ points: shape (count, *shape) for each output."""
        levels = random_levels(np.random.default_rng(seed), len(self.germs), count).T
        return self.at_germ(at_levels(self.germs.values(), levels))

    def __call__(self, inputs: Mapping[str, Any]) -> Pytree:
        """The expansion as a surrogate: the outputs at one plain value of each uncertain input, by name.

        Raises `ProblemError` for a value outside its distribution, and for dependent inputs: use `at_germ` for these.
        """
        point = germ_of(self.distributions, inputs)
        return jax.tree.map(lambda values: values[0], self.at_germ(np.array([[point[name] for name in self.germs]])))

    def cdf(self, values: Float[Array, " n"]) -> Pytree:
        """The distribution function at each value: shape (n, *shape) for each output."""
        return self._at_each(cdf, values)

    def pdf(self, values: Float[Array, " n"]) -> Pytree:
        """The probability density at each value, per unit of the output: shape (n, *shape) for each output."""
        return self._at_each(pdf, values)

    def _at_each(self, function: Callable[..., Array], values: Float[Array, " n"]) -> Pytree:
        lines = prepared(lines_through, self.basis)
        return jax.tree.map(lambda terms: function(values, terms, lines), self.coefficients)

    def covariance(self, first: str, second: str) -> Array:
        """The covariance of two outputs of equal shape, entry by entry."""
        return self._both(first, second).statistic(Covariance())

    def correlation(self, first: str, second: str) -> Array:
        """The correlation coefficient of two outputs of equal shape, entry by entry: between -1 and 1."""
        return self._both(first, second).statistic(Correlation())

    @abc.abstractmethod
    def _both(self, first: str, second: str) -> "AbstractExpanded":
        """Two outputs as one, along a new last axis."""


def _statistic_of(kind: AbstractStatistic, constants: Pytree, terms: Array) -> tuple[Any, Any]:
    """A statistic, and the error of its integral where it is one of a tail."""
    if isinstance(kind, AbstractTail) and not is_traced((kind, terms, constants)):
        return kind.estimated(np.asarray(terms), constants)
    return kind.of(terms, constants), None


def _warn_of_integral(kind: AbstractStatistic, value: np.ndarray, error: np.ndarray, std: np.ndarray) -> None:
    """Warn (`ExpansionWarning`) of a statistic of a tail whose integral has an error that one would act on."""
    size = np.maximum(np.minimum(value, 1 - value) if isinstance(kind, Probability) else std, _NO_TAIL)
    worst = np.unravel_index(int(np.argmax(error / size)), error.shape)
    if error[worst] > _INTEGRATED * size[worst]:
        warnings.warn(
            f"{kind.text('output')} of the expansion is {value[worst]:.3g} ± {error[worst]:.1g} (95 %): few of the "
            "lines along which it is integrated meet that tail, or a density has a gap there.",
            ExpansionWarning,
            stacklevel=4,
        )


def with_points_left_out(
    kind: AbstractStatistic,
    collocation: Collocation | None,
    samples: Any,
    terms: Float[Array, "terms *shape"],
    constants: Any,
) -> Float[np.ndarray, "terms some *shape"] | None:
    """The coefficients, and those without one of the points each, for statistics of third and fourth powers.

    The leave-one-out error is one of values, to which mean and spread owe theirs. High powers of polynomials may
    instead owe theirs to tails so far out that no point is near: there each point that is left out makes them another
    number.

    None for other statistics, where the numbers are being traced, and where it would take long.
    """
    if collocation is None or not isinstance(kind, Skewness | Kurtosis | CornishFisher):
        return None
    if any(map(is_traced, (samples, terms, collocation.points))):
        return None
    known = np.asarray(terms)
    most = min(_PRODUCTS // max(constants.values.size * known[0].size, 1), _MOST_LEFT_OUT)
    return np.concatenate([known[:, None], left_out(collocation, np.asarray(samples), known, most)], axis=1)


def warn_of_shape(
    kind: AbstractStatistic, values: Float[np.ndarray, "some *shape"], terms: Float[np.ndarray, "terms *shape"]
) -> None:
    """Warn (`ExpansionWarning`) of a statistic with an error by the jackknife that one would act on."""
    value, std = values[0], np.asarray(Std().of(jax_array(terms), ()))
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.sqrt(np.sum((values[1:] - value) ** 2, axis=0))
    size = std if isinstance(kind, CornishFisher) else np.maximum(np.abs(value), 1.0)
    told = ~(error <= _TOLD * size) & (std > _NEGLIGIBLE * np.max(std, initial=0.0))
    if told.any():
        worst = np.unravel_index(int(np.argmax(np.where(told, error / size, 0.0))), value.shape)
        warnings.warn(
            f"{kind.text('output')} of the expansion is {value[worst]:.3g} ± {error[worst]:.1g} by the jackknife: it "
            "hangs on tails that no collocation point is near. Raise the order, or take al.references.monte_carlo.",
            ExpansionWarning,
            stacklevel=4,
        )


def _use(terms: Float[Array, "terms *shape"]) -> Use:
    return Use.ONCE if math.prod(terms.shape[1:]) <= _FEW else Use.LOOPS


def paired(outputs: Pytree, first: str, second: str) -> Array:
    """Two outputs of a dict, stacked along a new last axis."""
    library, both = in_library((part(outputs, first), part(outputs, second)))
    shapes = [jax.tree.map(lambda values: values.shape[1:], output) for output in both]
    if shapes[0] != shapes[1]:
        raise ProblemError(f"'{first}' and '{second}' have different shapes: {shapes[0]} and {shapes[1]}.")
    return jax_array(library.stack(both, axis=-1))


def checked_points(points: Any, germs: Mapping[str, AbstractGerm]) -> Float[np.ndarray, "n variables"]:
    """Germ points as an array of the right shape."""
    array = np.asarray(points, dtype=float)
    if array.ndim != 2 or array.shape[1] != len(germs):
        raise ProblemError(
            f"at_germ: expected germ points of shape (n, {len(germs)}), for {list(germs)}; received {array.shape}."
        )
    return array


def germ_of(distributions: Mapping[str, AbstractDistribution], inputs: Mapping[str, Any]) -> dict[str, float]:
    """The germ values at which the uncertain inputs have given values.

    Raises `ProblemError` if an input is missing or unknown, if a value lies outside its distribution, or if that
    depends on several germ variables.
    """
    if not isinstance(inputs, Mapping) or set(inputs) != set(distributions):
        raise ProblemError(f"Expected a dict with a value for each of {list(distributions)}; received {inputs!r}.")
    point = {}
    for name, distribution in distributions.items():
        germs = distribution.germs(name)
        if len(germs) != 1:
            raise ProblemError(f"'{name}' depends on the germ variables {list(germs)}: use at_germ(points).")
        ((variable, germ),) = germs.items()
        point[variable] = _inverted(name, distribution, germ, real(name, inputs[name]))
    return point


def _inverted(name: str, distribution: AbstractDistribution, germ: AbstractGerm, value: float) -> float:
    """The germ value at which a distribution has a given value, found by bracketing: it increases with its germ."""

    def excess(point: float) -> float:
        return float(jax.lax.stop_gradient(distribution.realised((jax_array(point),)))) - value

    ends = germ.support()
    low, high = (
        end if np.isfinite(end) else float(germ.quantile(np.array(level)))
        for end, level in zip(ends, _FURTHEST_LEVELS, strict=True)
    )
    while np.isinf(ends[1]) and high < _FURTHEST and excess(high) < 0:
        high *= 2
    rounding = 1e-12 * (1 + abs(value))
    if excess(low) > rounding or excess(high) < -rounding:
        raise ProblemError(f"'{name}' = {value:g} lies outside its distribution {distribution}.")
    if excess(low) >= 0 or excess(high) <= 0:
        return low if excess(low) >= 0 else high
    return float(scipy.optimize.brentq(excess, low, high, xtol=1e-14))  # type: ignore[arg-type]


def as_lines(rows: list[tuple[str, str]]) -> str:
    """Labelled lines."""
    width = max([11, *(len(label) for label, _ in rows)])
    return "\n".join(f"{label:<{width}} {text}" for label, text in rows)


def distribution_rows(distributions: Mapping[str, AbstractDistribution]) -> list[tuple[str, str]]:
    """The distribution of each uncertain input."""
    return [(name, f"~ {distribution}") for name, distribution in distributions.items()]


def output_rows(means: Pytree, stds: Pytree, remarks: Pytree) -> list[tuple[str, str]]:
    """Mean and standard deviation of each output, of an array at its largest spread; then its remarks."""
    rows = []
    for name, mean, std, remark in _aligned(means, stds, remarks):
        known_mean, known_std = concrete(mean), concrete(std)
        if known_mean is None or known_std is None:
            rows.append((name, "is being compiled: its numbers are not known yet"))
            continue
        entry = np.unravel_index(int(np.argmax(known_std)), known_std.shape)
        moments = f"mean {known_mean[entry]:.6g}, std {known_std[entry]:.4g}"
        rows.append((name, f"{_where(known_std.shape, entry)}{moments}{remark(entry)}"))
    return rows


def nothing(entry: tuple) -> str:
    """No remark on an entry."""
    del entry
    return ""


def _aligned(*trees: Pytree) -> Iterator[tuple[Any, ...]]:
    paths = [path for path, _ in jax.tree_util.tree_leaves_with_path(trees[0])]
    names = [jax.tree_util.keystr(path, simple=True, separator=".") or "output" for path in paths]
    yield from zip(names, *map(jax.tree.leaves, trees), strict=True)


def _where(shape: tuple[int, ...], entry: tuple) -> str:
    if not shape:
        return ""
    place = ", ".join(str(int(index)) for index in entry)
    return f"{'×'.join(map(str, shape))} numbers, of the largest spread [{place}]: "


def contributors(
    distributions: Mapping[str, AbstractDistribution], basis: AbstractBasis, terms: Float[np.ndarray, " terms"]
) -> str:
    """The largest shares of the variance by the inputs that they come from, alone or together (Sobol indices).

    A correlated group counts as one input: Shapley effects give the contributions of its members.
    """
    group = {
        germ: f"({distribution.dependence.group})"
        for distribution in distributions.values()
        if distribution.dependence
        for germ in distribution.germ_names("")
    }
    variance = np.sum(terms[1:] ** 2)
    if not variance > (_ROUNDING * float(np.abs(terms[0]))) ** 2:
        return "it does not vary"
    shares: dict[str, float] = {}
    for degrees, coefficient in zip(basis.indices[1:], terms[1:], strict=True):
        name = "·".join(
            dict.fromkeys(group.get(name, name) for name, degree in zip(basis.names, degrees, strict=True) if degree)
        )
        shares[name] = shares.get(name, 0.0) + float(coefficient**2 / variance)
    largest = sorted(shares.items(), key=lambda item: -item[1])[:_CONTRIBUTORS]
    return ", ".join(f"{name} {100 * share:.3g} %" for name, share in largest if share > _LEAST_SHARE)


def extrapolates(leave_one_out: Any, jackknife: Any, tolerance: float) -> bool:
    """Whether an expansion that predicts its own points extrapolates elsewhere, as into tails."""
    return bool(np.isfinite(leave_one_out) and leave_one_out <= tolerance < jackknife)


def trust(leave_one_out: Any, jackknife: Any, error: Any, tolerance: float, *, is_fresh: bool) -> str:
    """How well the expansion is resolved: by its leave-one-out error or, where points leave none, by fresh points or
    its last terms.
    """
    if extrapolates(leave_one_out, jackknife, tolerance):
        return f"jackknife error {float(jackknife):.1e} (EXTRAPOLATED, take al.points.InducedPoints())"
    if np.isfinite(leave_one_out) and leave_one_out <= tolerance < error:
        return f"error at fresh points {float(error):.1e} (NOT RESOLVED, take more points)"
    if not np.isfinite(leave_one_out):
        by, shown = f"error {'at fresh points' if is_fresh else 'by the decay of its degrees'}", error
    else:
        by, shown = "leave-one-out error", leave_one_out
    verdict = "resolved" if float(error) <= tolerance else "NOT RESOLVED, raise the order"
    return f"{by} {float(shown):.1e} ({verdict})"
