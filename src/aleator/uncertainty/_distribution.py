"""`AbstractDistribution`: an uncertain number of a model, and what every family of distributions shares."""

import abc
import itertools
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from aleator._core.arrays import Scalar
from aleator._core.errors import ProblemError
from aleator.uncertainty._decision import Decision
from aleator.uncertainty._polynomials import AbstractGerm


class Canonical(NamedTuple):
    """A law as `location + scale * germ`, with the shape parameters of its germ (none, one or two numbers)."""

    location: Scalar
    scale: Scalar
    shape: tuple[Scalar, ...] = ()


class Form(NamedTuple):
    """One way to give a distribution's parameters: how they become canonical, and which of them set the shape."""

    canonical: Callable[..., Canonical]
    shaped_by: frozenset[str] = frozenset()


class AbstractDistribution(eqx.Module):
    """An uncertain number, placed anywhere in a model. Each of its parameters may be a number or a `Decision`.

    The germ `xi` is fixed and the number is `location + scale * xi` (dissertation, equations 13 and 14), so that
    decisions inside a distribution move the number but not the collocation points in germ space. Where a decision sets
    the *shape* of a law, `xi` is transported from the initial law to the current one at equal probability.

    Two placements are two independent variables, even of the same object, unless both were made with `shared("name")`:
    then they are one and the same realisation.
    """

    parameters: dict[str, Any]
    shared_name: str | None = eqx.field(static=True)

    FORMS: ClassVar[dict[tuple[str, ...], Form]]

    def _take(self, given: dict[str, Any], shared_name: str | None) -> None:
        """Store the parameters that were given, after checking that they make a law."""
        parameters = {name: _plain(name, value, type(self)) for name, value in given.items() if value is not None}
        self.parameters = parameters
        self.shared_name = shared_name
        self._names()
        if not any(isinstance(value, Tracer) for value in jax.tree.leaves(parameters)):
            self._check()

    def shared(self, name: str) -> Self:
        """The same realisation wherever it is placed: all placements shared under one name are one random variable."""
        return type(self)(**self.parameters, shared_name=name)

    def _names(self) -> tuple[str, ...]:
        """The parameters' names in their declared order, which a dict does not keep when JAX takes it apart."""
        for names in self.FORMS:
            if set(names) == set(self.parameters):
                return names
        ways = " or ".join(f"({', '.join(names)})" for names in self.FORMS)
        raise ProblemError(f"{type(self).__name__} takes {ways}; received ({', '.join(self.parameters)}).")

    @property
    def form(self) -> Form:
        """How the parameters were given."""
        return self.FORMS[self._names()]

    def _check(self) -> None:
        """Refuse parameters that make no law, at the start of the decisions or anywhere between their bounds."""
        start = {name: float(value) for name, value in self.initial().parameters.items()}
        if "upper" in start and not start["lower"] < start["upper"]:
            raise ProblemError(f"{type(self).__name__} needs lower < upper; received {self}.")
        location, spread, shape = self._numbers(start)
        positive = [spread, *shape]
        if not np.all(np.isfinite([location, *positive])) or min(positive) <= 0:
            raise ProblemError(
                f"{type(self).__name__} needs finite parameters, a positive spread and positive shape parameters; "
                f"received {self}."
            )
        for corner in self.corners():
            self._check_corner(corner, *self._numbers(start | corner))

    def _numbers(self, parameters: dict[str, float]) -> tuple[float, float, tuple[float, ...]]:
        """Location, spread and shape of a law that need not exist: they may be negative, infinite or not a number."""
        with np.errstate(all="ignore"):
            location, scale, shape = self.form.canonical(**{name: np.float64(v) for name, v in parameters.items()})
        # A given standard deviation is squared on its way to some canonical forms, which hides its sign.
        spread = np.min([float(scale), parameters.get("std", float(scale))])
        return float(location), float(spread), tuple(float(number) for number in shape)

    def _check_corner(self, corner: dict[str, float], location: float, spread: float, shape: tuple[float, ...]) -> None:
        """Refuse decisions that reach no law at one corner of their bounds, where only the spread may vanish.

        A location or a spread without bound is an allowed decision; a shape parameter without bound is no law.
        """
        bounded = bool(np.all(np.isfinite(list(corner.values()))))
        finite = np.all(np.isfinite([location, spread])) or not bounded
        if finite and spread >= 0 and all(0 < number < np.inf for number in shape):
            return
        where = ", ".join(f"{name}={value:g}" for name, value in corner.items())
        received = ", ".join([f"spread {spread:g}", *(f"shape {number:g}" for number in shape)])
        remedy = "Narrow the bounds of its decisions." if bounded else "Give the decision finite bounds."
        raise ProblemError(
            f"{type(self).__name__}: its decisions reach {where}, where it is no distribution: expected a spread of "
            f"at least 0 and shape parameters that are positive and finite; received {received} from {self}. {remedy}"
        )

    def corners(self) -> Iterator[dict[str, float]]:
        """Every combination of the bounds of the decisions, by parameter name.

        They decide whether all decisions make a law, and how far it reaches: location, scale and the ends of the
        support are monotone in each parameter, and a Beta's variance is below its limit everywhere if it is there.
        """
        # Decisions shared under one name move together.
        key = {name: (decision.shared_name, decision.shared_name or name) for name, decision in self.decisions.items()}
        keys = list(dict.fromkeys(key.values()))
        for ends in itertools.product(("lower", "upper"), repeat=len(keys)):
            end = dict(zip(keys, ends, strict=True))
            yield {name: float(getattr(decision, end[key[name]])) for name, decision in self.decisions.items()}

    def canonical(self) -> Canonical:
        """Location, scale and shape, once the parameters are plain numbers."""
        return self.form.canonical(**self.parameters)

    def initial(self) -> Self:
        """The distribution at the initial values of its decisions."""
        return self.decided(lambda _, decision: decision.initial)

    def decided(self, choose: Callable[[str, Decision], Any]) -> Self:
        """The distribution with `choose(parameter_name, decision)` in the place of each decision."""
        chosen = {
            name: choose(name, value) if isinstance(value, Decision) else value
            for name, value in self.parameters.items()
        }
        return eqx.tree_at(lambda law: law.parameters, self, chosen, is_leaf=lambda leaf: isinstance(leaf, dict))

    @property
    def decisions(self) -> dict[str, Decision]:
        """The decisions among the parameters, by parameter name."""
        ordered = ((name, self.parameters[name]) for name in self._names())
        return {name: value for name, value in ordered if isinstance(value, Decision)}

    @property
    def shape_is_decided(self) -> bool:
        """Whether a decision sets a shape parameter, so that the law changes by more than location and scale."""
        return not self.form.shaped_by.isdisjoint(self.decisions)

    def value(self, germ: Float[Array, ""], reference: tuple[Scalar, ...] | None = None) -> Float[Array, ""]:
        """The number at the germ value `germ`, which belongs to the shape `reference` (default: the current one)."""
        location, scale, shape = self.canonical()
        if reference is not None:
            germ = self.transport(germ, reference, shape)
        return jnp.asarray(location + scale * germ)

    def transport(self, germ: Float[Array, ""], source: tuple, target: tuple) -> Float[Array, ""]:
        """Move a germ value between two shapes at equal probability. Families without shape have nothing to move."""
        del source, target
        return germ

    @abc.abstractmethod
    def germ(self) -> AbstractGerm:
        """The germ's law and polynomials, at the initial values of the decisions."""

    @abc.abstractmethod
    def mean(self) -> Scalar:
        """The mean, once the parameters are plain numbers."""

    @abc.abstractmethod
    def std(self) -> Scalar:
        """The standard deviation, once the parameters are plain numbers."""

    @abc.abstractmethod
    def support(self) -> tuple[Scalar, Scalar]:
        """Smallest and largest possible value, once the parameters are plain numbers."""

    def __str__(self) -> str:
        inside = ", ".join(f"{name}={_brief(self.parameters[name])}" for name in self._names())
        return f"{type(self).__name__}({inside})"


def _plain(name: str, value: Any, family: type) -> Any:
    """A parameter as a float, a scalar array or a scalar `Decision`."""
    if isinstance(value, Decision):
        if np.ndim(value.initial) == 0:
            return value
        received = f"a Decision of shape {np.shape(value.initial)}"
    elif isinstance(value, jax.Array) and value.ndim == 0:
        return value
    elif isinstance(value, int | float | np.number | np.ndarray) and _is_one_real(np.asarray(value)):
        return float(value)
    else:
        received = f"{type(value).__name__} {value!r}"
    raise ProblemError(f"{family.__name__}: '{name}' takes one number or one Decision; received {received}.")


def _is_one_real(value: np.ndarray) -> bool:
    return value.ndim == 0 and value.dtype.kind in "iuf"


def _brief(value: Any) -> str:
    if isinstance(value, Decision):
        return f"Decision({float(value.initial):g} in [{float(value.lower):g}, {float(value.upper):g}])"
    return f"{float(value):g}" if not isinstance(value, Tracer) else "traced"
