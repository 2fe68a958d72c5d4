"""`AbstractDistribution`: an uncertain number of a model; the base class of all families."""

import abc
import itertools
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.core import Tracer
from jaxtyping import Array, Float

from aleator._core.arrays import Scalar, jax_array
from aleator._core.border import a_name, real_array, refusal
from aleator._core.errors import ProblemError
from aleator._core.identity import is_library
from aleator._core.leaves import AbstractLeaf, is_traced, realised_shape
from aleator.uncertainty._decisions import AbstractDecision
from aleator.uncertainty._polynomials import AbstractGerm, Dependence

# Probability levels at which methods of a user's own distribution are compared, and the tolerance by its spread.
_LEVELS = np.array([0.02, 0.16, 0.5, 0.84, 0.98])
_SAME = 1e-6


class Canonical(NamedTuple):
    """A distribution as `location + scale * germ`, with the shape parameters of its germ (none, one or two numbers)."""

    location: Scalar
    scale: Scalar
    shape: tuple[Scalar, ...] = ()


class Form(NamedTuple):
    """One way to give a distribution's parameters: their canonical form, and which of them set the shape."""

    canonical: Callable[..., Canonical]
    shaped_by: frozenset[str] = frozenset()


def constant(tree: Any) -> Any:
    """The same numbers without their derivatives: plain ones under `jax.grad`, but traced ones under `jax.jit`."""
    with jax.ensure_compile_time_eval():
        return jax.lax.stop_gradient(tree)


def plain(name: str, value: Any, family: type) -> Any:
    """A parameter as a float, a scalar array or a scalar `Decision`."""
    if isinstance(value, AbstractDecision | jax.Array) and realised_shape(value) == ():
        return value
    what, expected = f"{family.__name__}: '{name}'", "one number or one Decision"
    number = real_array(what, value, expected)
    if number.ndim:
        raise refusal(what, expected, value)
    return float(number)


def brief(value: Any) -> str:
    """A parameter as text."""
    if isinstance(value, AbstractDecision):
        return f"{type(value).__name__}({float(value.initial):g} in {value.domain()})"
    return f"{float(value):g}" if not isinstance(value, Tracer) else "traced"


class AbstractDistribution(AbstractLeaf):
    """An uncertain number, placed anywhere in a model. Each of its parameters may be a number or a `Decision`.

    The germ `xi` is fixed and the number is `location + scale * xi` (dissertation, equations 13 and 14), so that
    decisions inside a distribution move the number but not the collocation points in germ space. Where a decision sets
    the *shape* of a distribution, `xi` moves from the initial distribution to the current one at equal probability.

    Two placements are two independent variables, even of the same object, unless both were made with `shared("name")`:
    then they are one and the same realisation.
    """

    parameters: dict[str, Any]
    dependence: Dependence | None
    shared_name: str | None = eqx.field(static=True)
    held: bool = eqx.field(static=True, repr=False)
    """Whether it is held at its mean: it has no germ then."""

    FORMS: ClassVar[dict[tuple[str, ...], Form]]
    REQUIRES: ClassVar[str] = "finite parameters, a positive spread and positive shape parameters"
    REACHES_ENDS: ClassVar[bool] = True
    """Whether values come so close to a finite end of the support that the physics must hold at the end itself."""

    def set_parameters(self, parameters: dict[str, Any], shared_name: str | None) -> None:
        """Store the parameters that are not None after checking that they define a distribution."""
        self.parameters = {
            name: plain(name, value, type(self)) for name, value in parameters.items() if value is not None
        }
        self.dependence, self.held = None, False
        self.shared_name = None if shared_name is None else a_name(f"{type(self).__name__}: shared_name", shared_name)
        self._names()
        # The numbers are known under jax.grad, and so checked; under jax.jit they are not.
        if not is_traced(constant(self.parameters)):
            self._check()

    @property
    def is_uncertain(self) -> bool:
        """Whether realisations differ: not those of a distribution that is held at its mean."""
        return not self.held

    def at_mean(self, held: bool = True) -> Self:
        """The same distribution, held at its mean or again uncertain."""
        return self.with_fields(held=held)

    def _names(self) -> tuple[str, ...]:
        """The parameters' names in their declared order, which a dict loses when JAX flattens it."""
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
        """Refuse parameters that define no distribution, at the start or anywhere within the decisions' bounds."""
        start = {name: float(value) for name, value in constant(self.initial().parameters).items()}
        if "upper" in start and not start["lower"] < start["upper"]:
            raise ProblemError(f"{type(self).__name__} needs lower < upper; received {self}.")
        location, spread, shape = self._numbers(start)
        if not (np.all(np.isfinite([location, spread])) and spread > 0 and self._is_possible(start, shape)):
            raise ProblemError(f"{type(self).__name__} needs {self.REQUIRES}; received {self}.")
        if spread < np.finfo(float).tiny:  # which compiled programs round to zero
            raise ProblemError(f"{type(self).__name__}: expected a spread of at least 2.3e-308; received {self}.")
        for corner in self.corners():
            self._check_corner(start | corner, corner)
        if not is_library(type(self).__module__):
            refuse_contradictions(self.initial())

    def _is_possible(self, parameters: dict[str, float], shape: tuple[float, ...]) -> bool:
        """Whether a distribution of these parameters and this shape exists, whatever its location and spread."""
        del parameters
        return all(0 < number < np.inf for number in shape)

    def _numbers(self, parameters: dict[str, float]) -> tuple[float, float, tuple[float, ...]]:
        """Location, spread and shape, even impossible ones: negative, infinite or NaN."""
        with np.errstate(all="ignore"), jax.ensure_compile_time_eval():
            location, scale, shape = self.form.canonical(**{name: np.float64(v) for name, v in parameters.items()})
        # Some canonical forms square a given standard deviation, which hides its sign.
        spread = np.min([float(scale), parameters.get("std", float(scale))])
        return float(location), float(spread), tuple(float(number) for number in shape)

    def _check_corner(self, parameters: dict[str, float], corner: dict[str, float]) -> None:
        """Refuse decisions that define no distribution at one corner of their bounds; only the spread may vanish there.

        A decided location or spread may be unbounded, but not a shape parameter.
        """
        location, spread, shape = self._numbers(parameters)
        bounded = bool(np.all(np.isfinite(list(corner.values()))))
        finite = np.all(np.isfinite([location, spread])) or not bounded
        if finite and spread >= 0 and self._is_possible(parameters, shape):
            return
        where = ", ".join(f"{name}={value:g}" for name, value in corner.items())
        received = ", ".join([f"spread {spread:g}", *(f"shape {number:g}" for number in shape)])
        remedy = "Narrow the bounds of its decisions." if bounded else "Give the decision finite bounds."
        raise ProblemError(
            f"{type(self).__name__}: its decisions reach {where}, where it is no distribution: expected "
            f"{self.REQUIRES} (only a spread may vanish); received {received} from {self}. {remedy}"
        )

    def corners(self) -> Iterator[dict[str, float]]:
        """Every combination of the decisions' bounds, by parameter name.

        They suffice to tell whether all decisions define a distribution, and how far it reaches: location, scale and
        the ends of the support are monotone in each parameter, and a Beta's variance is below its limit everywhere if
        it is at the corners.
        """
        # Decisions shared under one name move together.
        key = {name: (decision.shared_name, decision.shared_name or name) for name, decision in self.decisions.items()}
        keys = list(dict.fromkeys(key.values()))
        for ends in itertools.product(("lower", "upper"), repeat=len(keys)):
            end = dict(zip(keys, ends, strict=True))
            yield {name: float(getattr(decision, end[key[name]])) for name, decision in self.decisions.items()}

    @property
    def shape(self) -> tuple[int, ...]:
        """The array shape of one number, (). For the distribution's shape parameters see `concrete_shape`."""
        return ()

    def lowest(self) -> float | None:
        """The lower end of the support, at its lowest over the corners of the decisions' bounds."""
        return self._outermost(0, np.nanmin, np.inf)

    def highest(self) -> float | None:
        """The upper end of the support, at its highest over the corners of the decisions' bounds."""
        return self._outermost(1, np.nanmax, -np.inf)

    def _outermost(self, end: int, extreme: Callable[[list[float]], Any], inwards: float) -> float | None:
        """An end of the support over all corners of the decisions' bounds; None where numbers are traced.

        A corner at infinity may give NaN (infinity minus infinity), which is dropped; another corner has that end.
        """
        if is_traced(self):
            return None
        with np.errstate(invalid="ignore"), jax.ensure_compile_time_eval():
            corners = [self.decided(lambda name, _, at=corner: at[name]) for corner in self.corners()]
            value = float(extreme([float(corner.support()[end]) for corner in corners]))
        return value if self.REACHES_ENDS else float(np.nextafter(value, inwards))

    def canonical(self) -> Canonical:
        """Location, scale and shape, once the parameters are plain numbers."""
        return self.form.canonical(**self.parameters)

    def initial(self) -> Self:
        """The distribution at the initial values of its decisions."""
        return self.decided(lambda _, decision: decision.initial)

    def decided(self, choose: Callable[[str, AbstractDecision], Any]) -> Self:
        """The distribution with each decision replaced by `choose(parameter_name, decision)`."""
        chosen = {
            name: choose(name, value) if isinstance(value, AbstractDecision) else value
            for name, value in self.parameters.items()
        }
        return self.with_fields(parameters=chosen)

    @property
    def decisions(self) -> dict[str, AbstractDecision]:
        """The decisions among the parameters, by parameter name."""
        ordered = ((name, self.parameters[name]) for name in self._names())
        return {name: value for name, value in ordered if isinstance(value, AbstractDecision)}

    @property
    def shape_is_decided(self) -> bool:
        """Whether a decision sets a shape parameter, not only location and scale."""
        return not self.form.shaped_by.isdisjoint(self.decisions)

    def value(self, germ: Float[Array, ""], reference: tuple[Scalar, ...] | None = None) -> Float[Array, ""]:
        """The number at the germ value `germ`, whose distribution has the shape `reference` (default: the current)."""
        location, scale, shape = self.canonical()
        if reference is not None:
            germ = self.transport(germ, reference, shape)
        elif is_traced(shape):
            germ = self.anchor(germ, shape)
        return jax_array(location + scale * germ)

    def value_at_normal(self, normal: Float[Array, ""]) -> Float[Array, ""]:
        """The number at the same probability level as the standard normal value `normal`."""
        location, scale, shape = self.canonical()
        return jnp.asarray(location + scale * self.from_normal(normal, shape))

    def transport(self, germ: Float[Array, ""], source: tuple, target: tuple) -> Float[Array, ""]:
        """Move a germ value between two shapes at equal probability. Families without a shape do nothing."""
        del source, target
        return germ

    def anchor(self, germ: Float[Array, ""], shape: tuple) -> Float[Array, ""]:
        """The unchanged germ value, with its derivative with respect to the shape at equal probability.

        It is needed where the shape is differentiated from outside, as by `jax.grad`, rather than decided.
        """
        return self.transport(germ, jax.lax.stop_gradient(shape), shape)

    @abc.abstractmethod
    def from_normal(self, normal: Float[Array, ""], shape: tuple) -> Float[Array, ""]:
        """The germ value of the given shape at the same probability level as the standard normal value `normal`."""

    def reference(self) -> tuple[Scalar, ...] | None:
        """The initial shape, with which the germ is distributed, where a decision sets the shape; else `None`."""
        return self._constant_shape() if self.shape_is_decided else None

    def concrete_shape(self) -> tuple[float, ...]:
        """The shape parameters of the germ as plain numbers, even while they are differentiated.

        Raises `ProblemError` where no numbers are known, as under `jax.jit` or `jax.vmap`.
        """
        shape = self._constant_shape()
        if is_traced(shape):
            raise ProblemError(
                f"{type(self).__name__}: the polynomials of its germ need a shape of known numbers; received one "
                "traced by jax.jit or jax.vmap. Build the expansion outside of them (jax.grad works)."
            )
        return tuple(float(number) for number in shape)

    def _constant_shape(self) -> tuple[Scalar, ...]:
        with jax.ensure_compile_time_eval():
            return self.form.canonical(**constant(self.initial().parameters)).shape

    def germ_names(self, place: str) -> tuple[str, ...]:
        """The germ variables on which it depends when placed at `place`.

        One, named after the place; for a correlated distribution its own and those of the members before it.
        """
        return (place,) if self.dependence is None else self.dependence.germ_names

    def germs(self, place: str) -> dict[str, AbstractGerm]:
        """The distribution of each germ variable that it depends on, by name, in the order of `germ_names`."""
        return {place: self.germ()} if self.dependence is None else self.dependence.germs

    def reach(self) -> tuple[float, float]:
        """From where to where its germ variable goes in a worst case: over its support."""
        return self.germ().support()

    def realised(
        self, germs: tuple[Float[Array, ""], ...], reference: tuple[Scalar, ...] | None = None
    ) -> Float[Array, ""]:
        """The number at the values of its germ variables, in the order of `germ_names`; see `value`."""
        if self.dependence is None:
            (germ,) = germs
            return self.value(germ, reference)
        return self.value_at_normal(self.dependence.normal(germs))

    @abc.abstractmethod
    def germ(self) -> AbstractGerm:
        """The germ's distribution and polynomials, at the initial values of the decisions."""

    def mean(self) -> Scalar:
        """The mean, once the parameters are plain numbers; a family with a shape has its own, as it has for `std`."""
        return self._at(self.germ().recurrence(0)[0][0])

    def std(self) -> Scalar:
        """The standard deviation, once the parameters are plain numbers."""
        scale, spread = self.canonical().scale, self.germ().recurrence(1)[1][1]
        return scale if spread == 1 else scale * spread

    def support(self) -> tuple[Scalar, Scalar]:
        """Smallest and largest possible value, once the parameters are plain numbers."""
        low, high = self.germ().support()
        return self._at(low), self._at(high)

    def _at(self, germ: float) -> Scalar:
        """The number at a constant germ value, which may be infinite."""
        location, scale, _ = self.canonical()
        return germ if np.isinf(germ) else location + scale * germ if germ else location

    def __str__(self) -> str:
        inside = ", ".join(f"{name}={brief(self.parameters[name])}" for name in self._names())
        return f"{type(self).__name__}({inside})"


def refuse_contradictions(distribution: Any) -> None:
    """Raise `ProblemError`, naming them, where methods of a distribution of plain numbers disagree or are missing."""
    own, base = type(distribution), AbstractDistribution
    needed = ("mean", "std", *(("transport",) if own.value is base.value else ()))
    missing = [f"{name}()" for name in needed if getattr(own, name) is getattr(base, name)]
    if missing and distribution.canonical().shape:
        raise ProblemError(
            f"{own.__name__} has a shape but no {' and no '.join(missing)} of its own: without it, derivatives with "
            "respect to the shape would be lost. transport(germ, source, target) moves values between shapes at equal "
            "probability. Write what is missing."
        )
    with jax.ensure_compile_time_eval():
        location, scale, shape = distribution.canonical()
        germ = distribution.germ()
        a, b = germ.recurrence(1)
        low, high = germ.support()
        quantiles = np.asarray(germ.quantile(_LEVELS), dtype=float)
        normal = [float(distribution.from_normal(np.asarray(z), shape)) for z in scipy.special.ndtri(_LEVELS)]
        methods = {
            f"from_normal at the levels {_LEVELS.tolist()}": (normal, quantiles),
            "mean": (distribution.mean(), location + scale * a[0]),
            "std": (distribution.std(), scale * b[1]),
            "support": (distribution.support(), (location + scale * low, location + scale * high)),
        }
    for name, (values, expected) in methods.items():
        values, expected = np.asarray(values, dtype=float), np.asarray(expected, dtype=float)
        size = 1.0 if name.startswith("from_normal") else abs(float(scale))
        if not (values.shape == expected.shape and np.allclose(values, expected, rtol=_SAME, atol=_SAME * size)):
            by_germ, received = (", ".join(f"{x:.6g}" for x in np.ravel(side)) for side in (expected, values))
            raise ProblemError(
                f"{own.__name__}: its germ and its {name} contradict each other: expected "
                f"{by_germ} by germ(); received {received}."
            )
