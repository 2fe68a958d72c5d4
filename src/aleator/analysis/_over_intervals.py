"""`OverIntervals`: an expansion in which some numbers are intervals, so that each statistic has a least and a largest
value.
"""

import itertools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import numpy as np
import scipy
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Pytree, in_library, jax_array
from aleator._core.border import real, refusal
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module, Printed, is_traced
from aleator.analysis._abstract_expanded import as_lines, distribution_rows
from aleator.analysis._expanded import Expanded
from aleator.ensemble import Points, spread_over
from aleator.expansion import AbstractBasis, Basis, sorted_terms
from aleator.statistics import AbstractMeasured, AbstractStatistic
from aleator.uncertainty import AbstractDecision, AbstractDistribution, Interval, constant

# The search for extremes goes on from the best points for so many numbers; of more, the best points are taken, of one
# interval so many.
_CONTINUED, _SCANNED = 16, 257
_TINY = np.finfo(float).tiny


class Bounds(NamedTuple):
    """The least and the largest value of a statistic over the intervals, entry by entry, and where they are.

    - `lower`, `upper`: numbers, in the shape of the statistic;
    - `at_lower`, `at_upper`: the values of the intervals there by name, in the same shape.
    """

    lower: Float[np.ndarray, "*shape"]
    upper: Float[np.ndarray, "*shape"]
    at_lower: dict[str, Float[np.ndarray, "*shape"]]
    at_upper: dict[str, Float[np.ndarray, "*shape"]]

    def __str__(self) -> str:
        if np.ndim(self.lower):
            return f"{np.size(self.lower)} numbers from {np.min(self.lower):.6g} to {np.max(self.upper):.6g}"
        sides = (self.lower, self.at_lower), (self.upper, self.at_upper)
        texts = (f"{end:.6g} ({', '.join(f'{name} = {x:.6g}' for name, x in at.items())})" for end, at in sides)
        return " to ".join(texts)


@final
class OverIntervals(Module, Printed, AbstractMeasured[Pytree]):
    """Outputs as polynomials of the uncertain inputs and of intervals, to which no probability belongs.

    Every statistic is a function of the intervals; its least and largest value are `Bounds`, in the structure of the
    outputs: `expanded["y"].mean`, `expanded["y"].probability(above=3.0)`. `at` gives the expansion at values of the
    intervals, with all of its statistics, and `bounds` the extremes of any function of that.

    - `joint`: the expansion in all variables, the intervals last, each from -1 to 1. Its own statistics would take them
      for uniform, and mean nothing;
    - `distributions`: of the uncertain inputs, by name, whose parameters may be intervals; `intervals`: by name;
    - `basis`: the polynomials of the uncertain inputs alone.
    """

    joint: Expanded
    distributions: dict[str, AbstractDistribution]
    intervals: dict[str, Interval]
    basis: AbstractBasis = eqx.field(static=True)

    def __getitem__(self, name: str) -> "OverIntervals":
        return OverIntervals(self.joint[name], self.distributions, self.intervals, self.basis)

    def at(self, values: Mapping[str, Any]) -> Expanded:
        """The expansion at one number of each interval, by name: polynomials of the uncertain inputs alone.

        Differentiable by all other numbers, as `expand` is. The derivative of a bound is that of the statistic where
        the bound is, `expanded.at({"a": bounds.at_upper["a"]})`. Raises `ProblemError` for unknown names, missing ones,
        and numbers outside of their intervals.
        """
        if not isinstance(values, Mapping) or set(values) != set(self.intervals):
            raise refusal("at", f"a number of each of {list(self.intervals)}, by name", values)
        point = []
        for name, one in self.intervals.items():
            value, (low, high) = real(f"at: '{name}'", values[name]), map(float, constant((one.lower, one.upper)))
            if not low <= value <= high:
                raise ProblemError(f"at: expected '{name}' from {low:g} to {high:g}; received {value:g}.")
            point.append((value - low) / (high - low))
        return self.given(np.array(point))

    def given(self, point: Float[np.ndarray, " intervals"]) -> Expanded:
        """The expansion at a point of the unit box of the intervals."""
        values, joint, count = self.numbers(point), self.joint.basis, len(self.basis.germs)
        factors, germs = np.ones(joint.terms), list(joint.germs.values())
        for i, x in enumerate(point, count):
            factors *= germs[i].polynomials(joint.degrees[i], np.array([2 * x - 1]))[0][joint.indices[:, i]]
        rows = {tuple(term): row for row, term in enumerate(self.basis.indices.tolist())}
        matrix = np.zeros((self.basis.terms, joint.terms))
        matrix[[rows[tuple(term)] for term in joint.indices[:, :count].tolist()], np.arange(joint.terms)] = factors

        def given(terms: Float[Array, "terms *shape"]) -> Float[Array, "terms *shape"]:
            library, known = in_library(terms)
            return jax_array(library.tensordot(matrix, known, axes=1))

        def decided(name: str, distribution: AbstractDistribution) -> AbstractDistribution:
            def choose(parameter: str, one: AbstractDecision) -> Any:
                return values[one.shared_name or f"{name}.{parameter}"] if isinstance(one, Interval) else one.initial

            return distribution.decided(choose)

        distributions = {name: decided(name, one) for name, one in self.distributions.items()}
        coefficients = jax.tree.map(given, self.joint.coefficients)
        return Expanded(distributions, self.basis, coefficients, None, None, None, self.joint.tolerance)

    @override
    def statistic(self, kind: AbstractStatistic) -> Pytree:
        """The bounds of any other statistic of each output."""
        return self.bounds(lambda given: given.statistic(kind))

    def cdf(self, values: Float[Any, " n"]) -> Pytree:
        """The bounds of the distribution function at each value, entry by entry: a probability box."""
        return self.bounds(lambda given: given.cdf(values))

    def bounds(self, function: Callable[[Expanded], Pytree]) -> Pytree:
        """The bounds of a function of the expansion at values of the intervals, such as `lambda one: one.mean**2`.

        Extremes are sought from corners of the box and points inside, and from the best of these on by a quasi-Newton
        search, which is no proof. Of arrays of many numbers the best points are taken, of one interval some hundred.
        Raises `ProblemError` where a statistic has no value, and inside a JAX transformation.
        """
        if is_traced(self.joint.coefficients):
            raise ProblemError(
                "bounds: an extreme over intervals is sought with known numbers, outside of jax.grad and jax.jit; "
                "differentiate a statistic at the values where the bound is, expanded.at(...)."
            )
        first, structure = jax.tree.flatten(function(self.given(np.full(len(self.intervals), 0.5))))
        ends = np.cumsum([np.size(one) for one in first])

        def numbers(points: Points) -> Float[np.ndarray, "points numbers"]:
            leaves = (jax.tree.leaves(function(self.given(point))) for point in points)
            return np.stack([np.concatenate([np.ravel(np.asarray(one, dtype=float)) for one in row]) for row in leaves])

        def both(rows: Float[np.ndarray, "points numbers"]) -> Float[np.ndarray, "points sides"]:
            """Minus the numbers, and the numbers; of those that are positive the logarithms."""
            rows = np.where(positive, np.log(np.where(positive, np.maximum(rows, _TINY), 1.0)), rows)
            return np.concatenate([-rows, rows], axis=1)

        points = spread_over(len(self.intervals), 0)
        if points.shape[1] == 1 and ends[-1] > _CONTINUED:
            points = np.linspace(0.0, 1.0, _SCANNED)[:, None]
        known = numbers(points)
        if not (finite := np.isfinite(known).all(axis=1)).all():
            where = ", ".join(f"{name} = {x:.6g}" for name, x in self.numbers(points[~finite][0]).items())
            raise ProblemError(f"bounds: the statistic is not finite where {where}: narrow the interval.")
        # A probability may be least where it is a millionth of others.
        positive = (known > 0).all(axis=0)
        seen = both(known)
        best = np.column_stack([seen.max(axis=0), points[np.argmax(seen, axis=0)]])
        for i, range_ in enumerate(np.ptp(seen, axis=0)):
            if ends[-1] <= _CONTINUED and range_ > 0:
                further = scipy.optimize.minimize(
                    lambda point, i=i, range_=range_: -both(numbers(np.clip(point, 0.0, 1.0)[None]))[0, i] / range_,
                    best[i, 1:],
                    method="L-BFGS-B",
                    bounds=[(0.0, 1.0)] * len(self.intervals),
                )
                reached = np.append(-further.fun * range_, further.x)
                best[i] = reached if reached[0] > best[i, 0] else best[i]
        lower, upper = np.split(best, 2)
        least, largest = (np.where(positive, np.exp(one), one) for one in (-lower[:, 0], upper[:, 0]))

        def bounds_of(one: Any, end: int) -> Bounds:
            some, shape = slice(end - np.size(one), end), np.shape(one)
            places = (self.numbers(side[some, 1:].T) for side in (lower, upper))
            at = [{name: x.reshape(shape)[()] for name, x in one.items()} for one in places]
            return Bounds(least[some].reshape(shape)[()], largest[some].reshape(shape)[()], *at)

        return jax.tree.unflatten(structure, [bounds_of(one, end) for one, end in zip(first, ends, strict=True)])

    def numbers(self, points: Float[np.ndarray, "intervals *some"]) -> dict[str, Any]:
        """The numbers of the intervals at points of their unit box."""
        each = zip(self.intervals.items(), points, strict=True)
        return {name: one.lower + x * (one.upper - one.lower) for (name, one), x in each}

    @property
    def error(self) -> Pytree:
        """The estimated error of each output, relative to the spread that the uncertain inputs alone cause in it.

        It is that of `joint`, for which the intervals vary too; see `Expanded.error`.
        """
        is_random = self.joint.basis.indices[:, : len(self.basis.germs)].any(axis=1)

        def relative(error: Array, terms: Array) -> Array:
            library, error, terms = in_library(error, terms)
            random, whole = library.sum(terms[is_random] ** 2), library.sum(terms[1:] ** 2)
            ratio = library.where(random > 0, whole, 1.0) / library.where(random > 0, random, 1.0)
            return jax_array(error * library.sqrt(ratio))

        return jax.tree.map(relative, self.joint.error, self.joint.coefficients)

    def __repr__(self) -> str:
        return f"<OverIntervals: expansion over {', '.join(self.intervals)}>"

    def __str__(self) -> str:
        order, terms, variables = self.joint.basis.order, self.joint.basis.terms, self.joint.basis.variables
        rows = [("expansion", f"order {order} in {variables} variable{'s' * (variables != 1)}, {terms} terms")]
        rows += distribution_rows(self.distributions)
        rows += [(name, f"∈ {one.domain()}") for name, one in self.intervals.items()]
        pairs = jax.tree_util.tree_leaves_with_path((self.mean, self.std), is_leaf=lambda one: isinstance(one, Bounds))
        half, errors = len(pairs) // 2, jax.tree.leaves(self.error)
        for (path, mean), (_, std), error in zip(pairs[:half], pairs[half:], errors, strict=True):
            name = jax.tree_util.keystr(path[1:], simple=True, separator=".") or "output"
            rows.append((name, f"mean {mean}, std {std}; error {float(error):.1e}"))
        return as_lines(rows)


def over_intervals(
    joint: Expanded, distributions: dict[str, AbstractDistribution], intervals: dict[str, Interval]
) -> OverIntervals:
    """An expansion whose last germ variables are those of intervals."""
    own = len(joint.basis.germs) - len(intervals)
    germs = dict(itertools.islice(joint.basis.germs.items(), own))
    indices = sorted_terms(np.unique(joint.basis.indices[:, :own], axis=0))
    return OverIntervals(joint, distributions, intervals, Basis(germs, indices))
