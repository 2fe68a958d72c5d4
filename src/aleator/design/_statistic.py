"""`AbstractFunctional`, the base class of functionals, and its atoms in expressions: `Statistic` and `Extreme`."""

import abc
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, NoReturn, Self, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import in_library
from aleator._core.border import one_of, real, refusal
from aleator._core.errors import ProblemError
from aleator.design._expression import Constraint, Expression, Range
from aleator.design._scope import AbstractAtom, AbstractRandom, AbstractScope, Units, ordered
from aleator.dynamics import AbstractGrid, History, Occurrence
from aleator.statistics import AbstractMeasured, AbstractStatistic, Correlation, Covariance, Mean, Std, a_statistic


class AbstractOfFunctionals(AbstractAtom):
    """An atom made of functionals."""

    functionals: "eqx.AbstractVar[tuple[AbstractFunctional, ...]]"

    @property
    @override
    def subjects(self) -> tuple[str, ...]:
        return tuple(name for one in self.functionals for name in one.outputs or (one.output,))

    @property
    @override
    def measures(self) -> tuple[str, ...]:
        return tuple(one.text() for one in self.functionals)

    @property
    @override
    def is_path(self) -> bool:
        return any(one.is_path for one in self.functionals)


@final
class Extreme(AbstractOfFunctionals):
    """The largest (`side = 1`) or smallest (`side = -1`) value of one functional over realisations of the model.

    These are all that its distributions allow, or those at the collocation points alone (`at_points`). It evaluates to
    the functional on each realisation available: a bound on it is a bound on each of them.
    """

    functionals: "tuple[AbstractFunctional, ...]"
    side: int = eqx.field(static=True)
    at_points: bool = eqx.field(static=True, default=False)

    @override
    def evaluate(self, scope: AbstractScope) -> Array:
        return scope.realised(self.functionals[0])

    @override
    def text(self) -> str:
        return f"{'max' if self.side > 0 else 'min'}{'_k' if self.at_points else ''}[{self.measures[0]}]"

    @override
    def unit(self, units: Units) -> str:
        return self.functionals[0].unit(units.outputs)


class AbstractFunctional(AbstractRandom, AbstractMeasured[Expression]):
    """A quantity computed from one or more outputs on each realisation. Made by `integral`, `rms`, `terminal`, ...

    Its statistics over the uncertainty (`mean`, `std`, `quantile(0.99)`, `supremum`, ...) can be added, multiplied by
    numbers and compared with bounds; `at_most`, `at_least` and `within` bound one or both ends of its distribution.

    - `is_path`: whether it is one number an instant instead of one number;
    - `needs_time`: whether it is taken over time, which algebraic systems do not have;
    - `order`: of convergence in the step of the grid: 2 for most rules on the instants, such as the largest among
      them; integrals and values at an instant have the order of the integrator;
    - `symbol`: its text, with places for its outputs.
    """

    is_path: ClassVar[bool] = False
    needs_time: ClassVar[bool] = True
    order: ClassVar[int] = 2
    symbol: ClassVar[str] = ""
    outputs: tuple[str, ...] = eqx.field(static=True)

    def __check_init__(self) -> None:
        if not isinstance(self.outputs, tuple):
            raise ProblemError(
                f"{type(self).__name__}: expected the names of outputs as a tuple, such as ('x',); "
                f"received {self.outputs!r}."
            )
        for name in self.outputs:
            an_output(name)
        if numbers := [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(self)]:
            raise ProblemError(
                f"{type(self).__name__}: expected its numbers as static fields, such as `target: float = "
                f"eqx.field(static=True)`; received {', '.join(numbers)} without it."
            )

    @property
    def output(self) -> str:
        """The output that it is computed from; the first where there are several."""
        return self.outputs[0]

    @property
    def place(self) -> str:
        """A name that tells the phase that it is taken over, where there are phases."""
        return self.output

    def in_phase(self, phase: str) -> Self:
        """The same over a phase: of the outputs there."""
        return self._with(outputs=tuple(f"{phase}.{name}" for name in self.outputs))

    def _with(self, **fields: Any) -> Self:
        one = copy(self)  # a user's class may be made in another way
        for name, value in fields.items():
            object.__setattr__(one, name, value)
        return one

    @override
    def text(self) -> str:
        return self.symbol.format(*self.outputs) or f"{type(self).__name__}({', '.join(self.outputs)})"

    @abc.abstractmethod
    def evaluate(self, taken: "Taken", grid: AbstractGrid) -> Float[Array, "..."]:
        """The quantity on one realisation: a number, or for `path` one number per instant."""

    def reach(self, peaks: Mapping[str, Any], grid: AbstractGrid) -> Float[Any, "..."]:
        """The magnitude, if its outputs were at their peaks all the time: `peaks` are the means of these.

        It is the scale for quantities that happen to be small, such as the speed at the end of a motion.
        """
        del grid
        return peaks[self.output]

    def refuse_on(self, grid: AbstractGrid) -> None:
        """Raise `ProblemError` if it cannot be taken on a grid."""

    def unit(self, outputs: Mapping[str, str]) -> str:
        """Its unit, from those of outputs as far as known (see `statistics._units`): by default its output's."""
        return outputs.get(self.output, "")

    @override
    def statistic(self, kind: AbstractStatistic) -> Expression:
        return statistic(a_statistic(kind), self)

    def at_most(
        self,
        upper: float | Expression,
        *,
        sigmas: float = 0.0,
        probability: float | None = None,
        worst_case: bool = False,
        at_points: bool = False,
    ) -> Constraint:
        """The limit `mean + sigmas * std <= upper`, or one of three that do not assume a normal distribution.

        - `probability`: at most `upper` with this probability (`quantile(probability) <= upper`). For a path this holds
          at each instant separately, so that different systems may exceed it at different instants; for whole systems,
          limit its `peak`, or use `calibrate`;
        - `worst_case`: at most `upper` on the worst realisation that `solve` finds, of bounded, independent numbers;
        - `at_points`: at most `upper` on each realisation at the collocation points, `max_k[...]`, for unbounded
          distributions too. It says nothing of the systems in between, and hardens with the number of points.

        Raises `ProblemError` if more than one of the four is given.
        """
        return self._end(1, sigmas, probability, worst_case, at_points) <= upper

    def at_least(
        self,
        lower: float | Expression,
        *,
        sigmas: float = 0.0,
        probability: float | None = None,
        worst_case: bool = False,
        at_points: bool = False,
    ) -> Constraint:
        """The limit `mean - sigmas * std >= lower`, or one of three that do not assume a normal distribution.

        - `probability`: at least `lower` with this probability (`quantile(1 - probability) >= lower`);
        - `worst_case`: at least `lower` on the worst realisation that `solve` finds, of bounded, independent numbers;
        - `at_points`: at least `lower` on each realisation at the collocation points: see `at_most`.

        Raises `ProblemError` if more than one of the four is given.
        """
        return self._end(-1, sigmas, probability, worst_case, at_points) >= lower

    def within(
        self,
        lower: float | Expression,
        upper: float | Expression,
        *,
        sigmas: float = 0.0,
        probability: float | None = None,
        worst_case: bool = False,
        at_points: bool = False,
    ) -> Range:
        """Both `at_most(upper)` and `at_least(lower)`, under one name; `probability` is that of each side alone.

        Another name is given to both at once: `y.within(-1, 1).named("stroke")`.

        Raises `ProblemError` for bounds in the wrong order.
        """
        name, margin = ", ".join(self.outputs), (sigmas, probability, worst_case, at_points)
        if isinstance(lower, Expression) or isinstance(upper, Expression):
            return Range(self._end(1, *margin) <= upper, self._end(-1, *margin) >= lower).named(name)
        lower, upper = ordered(name, lower, upper)
        return Range(self._end(1, *margin) <= upper, self._end(-1, *margin) >= lower)

    def equals(self, other: float | Expression) -> NoReturn:
        """Refused with what to write: what varies from system to system equals a number in none but a few."""
        raise ProblemError(
            f"'{self.text()}' varies from system to system: expected a statistic of it, such as .mean.equals({other}), "
            "or .within(lower, upper)."
        )

    def _end(
        self, side: int, sigmas: float, probability: float | None, worst_case: bool, at_points: bool
    ) -> Expression:
        """The upper (`side = 1`) or lower (`side = -1`) end of its distribution."""
        multiple = real(f"'{self.text()}': sigmas", sigmas, least=0.0)
        for name, choice in (("worst_case", worst_case), ("at_points", at_points)):
            if not isinstance(choice, bool):
                raise refusal(f"'{self.text()}': {name}", "True or False", choice)
        chosen = {
            "sigmas": multiple > 0,
            "probability": probability is not None,
            "worst_case": worst_case,
            "at_points": at_points,
        }
        if sum(chosen.values()) > 1:
            names = [name for name, is_chosen in chosen.items() if is_chosen]
            raise ProblemError(f"'{self.text()}': expected one of {', '.join(chosen)}; received {names}.")
        if worst_case or at_points:
            return Expression((1.0,), (Extreme((self,), side, at_points),))
        if probability is not None:
            return self.quantile(probability if side > 0 else 1 - probability)
        return self.mean + side * multiple * self.std


class Taken(NamedTuple):
    """The data of one realisation for functionals: its outputs over time, the integrals that they need, the first
    occurrence of each event that they name, and the monodromy matrix of a cycle.
    """

    history: History
    integrals: Mapping[AbstractFunctional, Float[Array, "..."]]
    events: Mapping[str, Occurrence] = MappingProxyType({})
    monodromy: Any = ()


@final
class Statistic(AbstractOfFunctionals):
    """A statistic of a functional, or of several jointly, as for a covariance."""

    functionals: tuple[AbstractFunctional, ...]
    kind: AbstractStatistic

    @override
    def evaluate(self, scope: AbstractScope) -> Array:
        return scope.statistic(self.functionals, self.kind)

    @override
    def text(self) -> str:
        return self.kind.text(", ".join(self.measures))

    @override
    def unit(self, units: Units) -> str:
        return self.kind.unit(*(one.unit(units.outputs) for one in self.functionals))

    @property
    @override
    def is_spread(self) -> bool:
        return isinstance(self.kind, Std)

    @property
    def is_moment(self) -> bool:
        """Whether it is one of the moments that are told of every functional."""
        return isinstance(self.kind, Mean | Std) and len(self.functionals) == 1


def an_output(name: Any) -> str:
    """The name of an output, unchanged. Raises `ProblemError` for anything but a name."""
    if isinstance(name, str) and name:
        return name
    raise ProblemError(
        f"An output is given by its name, such as 'x', and several one by one; received {type(name).__name__} {name!r}."
    )


def statistic(kind: AbstractStatistic, *functionals: AbstractFunctional) -> Expression:
    """A statistic of a functional (or of several jointly) as an expression."""
    return Expression((1.0,), (Statistic(functionals, kind),))


def covariance(first: AbstractFunctional, second: AbstractFunctional) -> Expression:
    """The covariance of two functionals; at every instant if both are paths."""
    return _joint(Covariance(), first, second)


def correlation(first: AbstractFunctional, second: AbstractFunctional) -> Expression:
    """The correlation of two functionals, between -1 and 1."""
    return _joint(Correlation(), first, second)


def _joint(kind: AbstractStatistic, *functionals: Any) -> Expression:
    what = f"A {type(kind).__name__.lower()} is that of two functionals"
    return statistic(kind, *(one_of(what, one, AbstractFunctional, "al.rms('x')") for one in functionals))


def joined(values: Sequence[Float[Any, "..."]]) -> Float[Any, "..."]:
    """The argument of a statistic: the values of one functional, or of several along a new last axis."""
    if len(values) == 1:
        return values[0]
    library, values = in_library(values)
    return library.stack(values, axis=-1)


def path_of(limit: Constraint | AbstractFunctional) -> str:
    """The name of the output at whose instants a limit or a functional over time is known."""
    if not limit.is_path:
        return ""
    every = functionals_of((limit.expression,)) if isinstance(limit, Constraint) else (limit,)
    return next((one.place for one in every if one.is_path), "")


def instants_of(
    limit: Constraint | AbstractFunctional, grid: AbstractGrid, times: Callable[[], Any]
) -> Float[Any, " instants"]:
    """Those of the instants of a grid at which a limit or a functional is known; one, NaN, if it is not over time.

    `times`: all instants, which take a program where events end realisations: asked for only if they are needed.
    """
    return times()[grid.where(path_of(limit))] if limit.is_path else np.full(1, np.nan)


def functionals_of(expressions: tuple[Expression, ...]) -> tuple[AbstractFunctional, ...]:
    """All functionals in the expressions, each once, in order of appearance."""
    atoms = (atom for one in expressions for atom in one.leaves if isinstance(atom, AbstractOfFunctionals))
    return tuple(dict.fromkeys(one for atom in atoms for one in atom.functionals))


def statistics_in(expressions: tuple[Expression, ...]) -> tuple[Statistic, ...]:
    """All statistics in the expressions, in order of appearance."""
    return tuple(atom for one in expressions for atom in one.leaves if isinstance(atom, Statistic))


def numbers_of(
    functionals: Iterable[AbstractFunctional], taken: Taken, grid: AbstractGrid
) -> tuple[Float[Array, "..."], ...]:
    """The values of functionals on one realisation, as arrays of real numbers."""
    return tuple(jnp.asarray(one.evaluate(taken, grid.of(one.place)), dtype=float) for one in functionals)


def is_worst_case(constraint: Constraint) -> bool:
    """Whether a constraint bounds the worst realisation of the model."""
    return any(isinstance(atom, Extreme) and not atom.at_points for atom in constraint.expression.leaves)


def is_at_points(constraint: Constraint) -> bool:
    """Whether a constraint bounds the realisations at the collocation points."""
    return any(isinstance(atom, Extreme) and atom.at_points for atom in constraint.expression.leaves)


def extreme_functionals(expressions: tuple[Expression, ...]) -> tuple[Any, ...]:
    """The functionals whose worst case appears in the expressions, each once."""
    leaves = (leaf for one in expressions for leaf in one.leaves)
    return tuple(dict.fromkeys(one for leaf in leaves if isinstance(leaf, Extreme) for one in leaf.functionals))
