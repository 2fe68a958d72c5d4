"""`AbstractDistribution`: an uncertain number of a model, and what every family of distributions shares."""

import abc
from collections.abc import Callable
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

# Parameters that a law only has for positive values, whatever its family.
_NONNEGATIVE = frozenset({"half_width", "std", "scale", "alpha", "beta", "shape"})


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
        """Refuse parameters that make no law at the start of its decisions, and spreads that may turn negative."""
        for name, decision in self.decisions.items():
            if name in _NONNEGATIVE and float(decision.lower) < 0:
                raise ProblemError(
                    f"{type(self).__name__}: the Decision for '{name}' needs a lower bound of at least 0; "
                    f"received {self}."
                )
        given = {name: np.float64(value) for name, value in self.initial().parameters.items()}
        with np.errstate(all="ignore"):  # a division by zero leaves an infinity or a nan, refused below
            location, scale, shape = self.form.canonical(**given)
        # A given standard deviation is squared on its way to some canonical forms, which hides its sign.
        positive = [float(value) for value in (scale, *shape, given.get("std", 1.0))]
        if not np.all(np.isfinite([float(location), *positive])) or min(positive) <= 0:
            raise ProblemError(
                f"{type(self).__name__} needs finite parameters, a positive spread and positive shape parameters; "
                f"received {self}."
            )

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
