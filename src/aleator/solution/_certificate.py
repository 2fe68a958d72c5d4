"""How far an answer can be trusted: expansions, worst cases, fresh simulations; all in one, with its grid."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from aleator._core.leaves import Printed
from aleator.expansion import UNRESOLVED, Unseen
from aleator.solution._grid import Between, GridError, Smoothing, lines, system_text


@final
@dataclass(frozen=True)
class Moments(Printed):
    """Mean and standard deviation of one functional by the expansion: one number each, or one per instant."""

    mean: Float[np.ndarray, "*shape"]
    std: Float[np.ndarray, "*shape"]

    def __str__(self) -> str:
        return f"mean {ends(self.mean)}, standard deviation {ends(self.std)}"


def ends(values: Float[np.ndarray, "*shape"]) -> str:
    """A number, or from where to where many reach."""
    least, most = float(np.min(values)), float(np.max(values))
    return f"{least:.6g}" if np.ndim(values) == 0 else f"from {least:.6g} to {most:.6g}"


@final
@dataclass(frozen=True)
class ExpansionQuality(Printed):
    """How far the expansion can be trusted at the solution.

    - `order`, `terms`, `points`: of the expansion; for an adaptive one, as reached in the end;
    - `condition_number`: of the collocation matrix;
    - `leave_one_out`: for each functional, the rms error of predicting a collocation point from all others, relative
      to the standard deviation; zero if it varies by no more than rounding;
    - `unresolved_from`: for each path that is resolved only at first, the instant (s) from which on that error is too
      large: a fixed order does not resolve an arbitrarily long simulation;
    - `tolerance`: the relative error up to which a functional counts as resolved, as set in the `Expansion`;
    - `tangents`: for each functional, the leave-one-out error of its derivative by each decision that is a parameter of
      a distribution. It bounds the trust in derivatives of its statistics, and in the shadow prices computed from them;
    - `unseen`: the largest corner of the germ space without a collocation point, about which nothing is known; None if
      nothing is uncertain;
    - `elements`: into how many the germ space is divided.
    """

    order: int
    terms: int
    points: int
    condition_number: float
    leave_one_out: Mapping[str, float] = field(default_factory=dict)
    unresolved_from: Mapping[str, float] = field(default_factory=dict)
    tolerance: float = UNRESOLVED
    tangents: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    unseen: Unseen | None = None
    elements: int = 1

    @property
    def worst(self) -> float:
        """The largest leave-one-out error."""
        return max(self.leave_one_out.values(), default=0.0)

    @property
    def unresolved(self) -> tuple[str, ...]:
        """The functionals whose error is too large for their statistics to be trusted, at least at the end."""
        errors = self.leave_one_out.items()
        return tuple(text for text, error in errors if not error <= self.tolerance or text in self.unresolved_from)

    @property
    def can_be_checked(self) -> bool:
        """Whether there are more points than terms to check it by: not for interpolation or sparse quadrature."""
        return not any(np.isposinf(error) for error in self.leave_one_out.values())

    @property
    def remedy(self) -> str:
        """What resolves it better."""
        return "Raise the order" if self.elements == 1 else "Raise the order, or the budget of elements"

    def since(self, text: str) -> str:
        """From when on a path is not resolved, in words; empty for other functionals."""
        return f" from t = {self.unresolved_from[text]:.4g} s on" if text in self.unresolved_from else ""

    def tangent_sentence(self) -> str:
        """The derivative by a parameter of a distribution that is resolved worst; empty without such parameters."""
        every = {f"{text} by {name}": error for text, of in self.tangents.items() for name, error in of.items()}
        if not every:
            return ""
        worst = max(every, key=lambda one: np.inf if np.isnan(every[one]) else every[one])
        remedy = "" if every[worst] <= self.tolerance else ": not resolved, nor are shadow prices; raise the order"
        return f"by distribution parameters: worst leave-one-out error {every[worst]:.2e} ({worst}){remedy}"

    def __str__(self) -> str:
        if self.points == 1:
            return "nothing is uncertain"
        divided = "" if self.elements == 1 else f"{self.elements} elements of "
        return (
            f"{divided}order {self.order}, {self.terms} terms, {self.points} points, condition number "
            f"{self.condition_number:.3g}, worst leave-one-out error {self.worst:.2e}"
        )


@final
@dataclass(frozen=True)
class WorstRealisation(Printed):
    """The system that comes closest to a limit on the worst case, or breaks it most.

    - `name`, `text`: of the constraint; `value`: of its functional; `beyond`: the excess over the bound, negative
      inside; `time`: when (s), None if it is no limit over time;
    - `numbers`: the uncertain numbers of that system, by name.
    """

    name: str
    text: str
    value: float
    beyond: float
    time: float | None
    numbers: Mapping[str, float]

    def __str__(self) -> str:
        when = "" if self.time is None else f" at t = {self.time:.4g} s"
        return f"{self.name} reaches {self.value:.6g}{when} with {system_text(self.numbers)}"


@final
@dataclass(frozen=True)
class WorstCase(Printed):
    """The worst cases of a solution, found by a search over realisations of the model; the search is no proof.

    - `realisations`: the worst of each limit on the worst case, in the order of the constraints;
    - `scenarios`: the germ points at which the program imposed the limits, shape (scenarios, variables);
    - `rounds`: how often the program was solved, with more scenarios each time; `is_found`: whether no realisation was
      found in the end that breaks a limit by more than these;
    - `searched`: the number of realisations that were simulated, or whatever else `of` says.

    Of intervals (see `Interval`) they are the values at which statistics are worst, and `scenarios` are values too.
    """

    realisations: tuple[WorstRealisation, ...]
    scenarios: Float[np.ndarray, "scenarios variables"]
    rounds: int
    searched: int
    is_found: bool = True
    of: str = "realisations of the model"

    def rows(self) -> list[str]:
        """A line for each limit, then how they were found."""
        return [*map(str, self.realisations), f"the worst of {self.searched} {self.of}, in {self.rounds} rounds"]

    def __str__(self) -> str:
        return "\n".join(self.rows())


@final
@dataclass(frozen=True)
class SecondOpinion(Printed):
    """A few fresh simulations at the answer, compared with its expansions.

    - `samples`: how many systems were simulated;
    - `misses`: for each functional, the rms error of predicting a fresh system, relative to the standard deviation;
    - `contradictions`: one sentence for each disagreement: a functional whose prediction errs by more than twice the
      tolerance of the expansion, or an expression of the problem that the correction changes by more than four standard
      errors and by more than a hundredth of the effect of one standard deviation;
    - `broken`: why the design is no solution once the expansion is corrected: a limit that fails by more than a
      twentieth of a spread, or an objective that changes by more than was gained. Empty otherwise.

    So few systems miss rare events, such as a spike in a corner of the germ space: use `validate` for these.
    """

    samples: int
    misses: Mapping[str, float]
    contradictions: tuple[str, ...]
    broken: str

    @property
    def agrees(self) -> bool:
        """Whether the fresh simulations agree with the expansions."""
        return not self.contradictions

    @property
    def remedy(self) -> str:
        """What to do where they disagree; without predictions to compare, some system has no result at any order."""
        return "Raise the order" if self.misses else "Mend the model there, or bound the distributions"

    def __str__(self) -> str:
        if self.agrees:
            worst = max(self.misses.values(), default=0.0)
            return f"{self.samples} fresh simulations agree, missed by {worst:.2e} of their standard deviation at worst"
        return f"{self.samples} fresh simulations disagree: {'; '.join(self.contradictions[:3])}"


class Objection(NamedTuple):
    """What the model says against the optimum of a program: in a phrase, and in a sentence with the remedy."""

    phrase: str
    sentence: str


@final
@dataclass(frozen=True)
class Certificate(Printed):
    """How far an answer can be trusted: program, grid, expansion and model. `print` shows it.

    - `violation`, `stationarity`, `complementarity`: scaled residuals of the optimality conditions, recomputed;
    - `expansion`: the quality of the expansions;
    - `between`: how far limits over time are exceeded between instants; None if that was not checked;
    - `grid_error`: the difference to a finer grid with an integrator of another order; None for models without time;
    - `worst_case`: the worst realisations of limits on the worst case; None if there are no such limits;
    - `opinion`: fresh simulations at the answer, compared with the expansions; None where there is nothing to ask;
    - `smoothing`: the same design at half the widths of `al.smooth`; None without any;
    - `objections`: what else the model says against the answer, such as values that do not follow their derivatives;
    - `misled`: a sentence on large errors of the grid where the search began or ended, which may have misled it;
    - `departed`: how far a simulation departs from an unstable plan, whose steps were then checked from its own states;
    - `correlations`: which correlations of uncertain numbers are not those given, for decisions set their shapes;
    - `reaches`: how large each functional that was checked could be in a typical system, as the scale of its rounding.
    """

    violation: float
    stationarity: float
    complementarity: float
    expansion: ExpansionQuality
    between: Between | None = None
    grid_error: GridError | None = None
    worst_case: WorstCase | None = None
    opinion: SecondOpinion | None = None
    smoothing: Smoothing | None = None
    objections: tuple[Objection, ...] = ()
    misled: str = ""
    departed: str = ""
    correlations: str = ""
    reaches: Mapping[str, float] = field(default_factory=dict)

    @property
    def objection(self) -> Objection | None:
        """Why the optimum of the program is no answer to the model; None if it is one."""
        return next(self._objections(), None)

    def _objections(self) -> Iterator[Objection]:
        between, error, opinion, worst_case = self.between, self.grid_error, self.opinion, self.worst_case
        yield from self.objections
        if between is not None and not between.holds:
            sentence = f"solved at the instants of the grid, but {between}, or between=1 to check the instants alone"
            yield Objection("limits break between the instants", sentence)
        if error is not None and not error.is_usable:
            steps = f" on {error.steps} steps" if error.steps else ""
            yield Objection("the grid is too coarse", f"solved{steps}, but {error}")
        if opinion is not None and opinion.broken:
            sentence = f"{opinion.samples} fresh simulations do not confirm it: {opinion.broken}. {opinion.remedy}"
            phrase = "fresh simulations do not confirm the expansion"
            yield Objection(phrase, f"solved for the expansion, but {sentence}")
        if worst_case is not None and not worst_case.is_found:
            worst = max(worst_case.realisations, key=lambda one: one.beyond)
            sentence = (
                f"solved for the realisations found so far, but others break a limit. After {worst_case.rounds} rounds "
                f"{worst}, {worst.beyond:.3g} beyond its bound: each new design breaks it at another realisation. "
                "Narrow the distributions, or give the optimiser fewer decisions"
            )
            yield Objection("the worst case breaks a limit", sentence)

    @property
    def holds(self) -> bool:
        """Whether nothing that was checked speaks against the optimum of the program."""
        return self.objection is None

    def rows(self) -> list[tuple[str, str]]:
        """A label and a text for each printed line."""
        residuals = (
            f"violation {self.violation:.1e}, stationarity {self.stationarity:.1e}, "
            f"complementarity {self.complementarity:.1e} (scaled)"
        )
        departed = (
            f"unstable: simulated from its first instant, {self.departed}; so each step of the grid, or a phase that "
            "an event ends, was checked from the plan's own state, and the plan needs feedback"
        )
        rows = [
            ("between", self.between),
            ("grid", self.grid_error),
            ("smoothing", self.smoothing),
            ("open loop", self.departed and departed),
            *(("worst case", row) for row in (self.worst_case.rows() if self.worst_case else ())),
            ("certificate", residuals),
            ("expansion", self.expansion),
            ("derivatives", self.expansion.tangent_sentence()),
            ("fresh", self.opinion),
            ("correlated", self.correlations),
            ("not seen", self.expansion.unseen and self.expansion.unseen.sentence()),
        ]
        return [(label, str(text)) for label, text in rows if text]

    def __str__(self) -> str:
        return lines(self.rows())
