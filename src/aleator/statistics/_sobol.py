"""Sobol indices: how much of a variance comes from which inputs (Sudret, 2008, Global sensitivity analysis using
polynomial chaos expansions).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar, NoReturn, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import in_library, jax_array, quietly
from aleator._core.border import meant
from aleator._core.errors import ProblemError
from aleator.expansion import Basis
from aleator.statistics._statistic import AbstractStatistic, varies
from aleator.uncertainty import AbstractDistribution


@final
class Sobol(AbstractStatistic):
    """The Sobol index of a set of germ variables: their share of the variance by interaction, from 0 to 1.

    One name gives the first-order index, two the index of the pair without the parts of each alone. Zero if the output
    does not vary. Names are those of the germ, `basis.names`.
    """

    variables: tuple[str, ...] = eqx.field(static=True)

    dimensionless: ClassVar[bool] = True
    by_numpy: ClassVar[bool] = True

    def __init__(self, variables: str | tuple[str, ...]):
        names = (variables,) if isinstance(variables, str) else tuple(variables)
        if not names or len(set(names)) < len(names) or not all(isinstance(name, str) for name in names):
            raise ProblemError(f"Sobol: expected one name or several different ones; received {variables!r}.")
        self.variables = names

    @property
    @override
    def preparation(self) -> Callable[[Basis], Float[Array, " terms"]]:
        return ExactlyOf(self.variables)

    @override
    def of(
        self, coefficients: Float[Array, "terms *shape"], constants: Float[Array, " terms"]
    ) -> Float[Array, "*shape"]:
        return share(coefficients, constants)

    def of_sample(self, values: Float[Array, "samples *shape"]) -> NoReturn:
        """Not to be had from one sample."""
        del values
        _refuse_sample()

    @override
    def text(self, inside: str) -> str:
        return f"S({', '.join(self.variables)})[{inside}]"


@final
class TotalSobol(AbstractStatistic):
    """The share of the variance to which a germ variable contributes, alone or together with others, from 0 to 1."""

    variable: str = eqx.field(static=True)

    dimensionless: ClassVar[bool] = True
    by_numpy: ClassVar[bool] = True

    def __init__(self, variable: str):
        if not isinstance(variable, str):
            raise ProblemError(f"TotalSobol: expected the name of one variable; received {variable!r}.")
        self.variable = variable

    @property
    @override
    def preparation(self) -> Callable[[Basis], Float[Array, " terms"]]:
        return With(self.variable)

    @override
    def of(
        self, coefficients: Float[Array, "terms *shape"], constants: Float[Array, " terms"]
    ) -> Float[Array, "*shape"]:
        return share(coefficients, constants)

    def of_sample(self, values: Float[Array, "samples *shape"]) -> NoReturn:
        """Not to be had from one sample."""
        del values
        _refuse_sample()

    @override
    def text(self, inside: str) -> str:
        return f"ST({self.variable})[{inside}]"


@final
@dataclass(frozen=True)
class ExactlyOf:
    """Preparation: one for each term that depends on exactly these variables, else zero."""

    variables: tuple[str, ...]

    def __call__(self, basis: Basis) -> Float[Array, " terms"]:
        """The selection of a basis. Raises `ProblemError` for a name that it does not have."""
        if not basis.variables:
            return jnp.zeros(basis.terms)  # nothing is uncertain
        chosen = np.zeros(basis.variables, bool)
        chosen[[place_of(basis, name) for name in self.variables]] = True
        return jax_array(np.all((basis.indices > 0) == chosen, axis=1), float)


@final
@dataclass(frozen=True)
class With:
    """Preparation: one for each term that depends on this variable, else zero."""

    variable: str

    def __call__(self, basis: Basis) -> Float[Array, " terms"]:
        """The selection of a basis. Raises `ProblemError` for a name that it does not have."""
        if not basis.variables:
            return jnp.zeros(basis.terms)
        return jax_array(basis.indices[:, place_of(basis, self.variable)] > 0, float)


@quietly
def share(coefficients: Float[Array, "terms *shape"], selected: Float[Array, " terms"]) -> Float[Array, "*shape"]:
    """The part of the variance in the selected terms; zero, with derivative zero, if there is no variance."""
    library, coefficients, selected, spreads = in_library(coefficients, selected, varies(coefficients))
    squares = coefficients[1:] ** 2
    total = library.sum(squares, axis=0)
    part = library.tensordot(selected[1:], squares, axes=1) / library.where(spreads, total, 1.0)
    return jax_array(library.where(spreads, part, 0.0))


def refuse_correlated(distributions: Mapping[str, AbstractDistribution], kind: AbstractStatistic) -> None:
    """Raise `ProblemError` for a Sobol index of a correlated input.

    It would be that of the germ variables, which depend on the order in which the group was declared; the variance of
    correlated inputs has no such decomposition.
    """
    named = kind.variables if isinstance(kind, Sobol) else (kind.variable,) if isinstance(kind, TotalSobol) else ()
    groups = {
        name: distribution.dependence.group
        for place, distribution in distributions.items()
        if distribution.dependence is not None
        for name in (place, *distribution.germ_names(place))
    }
    for name in named:
        if name in groups:
            raise ProblemError(
                f"Sobol index: '{name}' belongs to the correlated group '{groups[name]}', whose variance has no parts "
                "that belong to one input alone. Take Shapley effects, which share it out among inputs: "
                "al.expand(...).shapley(name)."
            )


def place_of(basis: Basis, name: str) -> int:
    """The index of the germ variable with this name. Raises `ProblemError`, with a similar name, if there is none."""
    if name in basis.names:
        return basis.names.index(name)
    hint = meant(name, basis.names) or f" Expected one of {list(basis.names)}."
    raise ProblemError(f"Sobol index: there is no germ variable '{name}'.{hint}")


def _refuse_sample() -> NoReturn:
    raise ProblemError(
        "A Sobol index cannot be estimated from one sample of an output, which does not say which inputs its "
        "values come from: take it from al.expand, or use al.references.sobol_indices."
    )
