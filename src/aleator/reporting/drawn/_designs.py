"""Figures and facts of solutions: paths, histories of simulated systems, decisions, states, costates, switching."""

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from aleator._core.arrays import jax_array
from aleator._core.border import positive, whole
from aleator._core.errors import ProblemError
from aleator.design import history
from aleator.reporting._designs import mesh_figure, search_figure
from aleator.reporting._numbers import (
    given,
    number,
    unit_of_decision,
    unit_of_expression,
    unit_of_objective,
    units_of_outputs,
)
from aleator.reporting._paths import (
    components,
    histories_figure,
    limits_of,
    limits_text,
    motion_figure,
    path_figure,
    paths_of,
)
from aleator.reporting._style import ALARM, LIMIT, MUTED, SIZE, Look, blank, draw, label, looks, plain, stacked
from aleator.reporting._tables import design_rows, side_by_side, status_words
from aleator.reporting.drawn._facts import AbstractPlots, Facts, chosen, facts_of, plots_of, unknown
from aleator.solution import Costates, MeshError, Solution, States, Switching
from aleator.solving import simulate_systems
from aleator.uncertainty import AbstractDecision, placements

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


def _over_time(solution: Solution) -> Mapping[str, str]:
    """Which of the outputs, inputs and states of a system each is, by name. Raises `ProblemError` without time."""
    problem = solution.problem
    if not problem.system.has_time:
        raise ProblemError("plot.histories: expected a system that evolves in time; received an algebraic one.")
    germ = jax_array(np.zeros(len(problem.placements.germs)))
    outputs = jax.eval_shape(lambda: history(problem, germ, jax_array(solution.vector)))
    others = dict.fromkeys(getattr(problem.system, "states", ()), "states") | dict.fromkeys(problem.inputs, "inputs")
    return {**dict.fromkeys(outputs, "outputs"), **{name: kind for name, kind in others.items() if name not in outputs}}


_NO_STATE = "expected states that are variables of the program; received a system without states."
# What each quantity of all realisations is called in its figure, and what is said where there is none.
_OF_REALISATIONS = {
    "state": ("{}", _NO_STATE),
    "costate": ("Costate of {}", _NO_STATE),
    "input": ("Switching function of {}", "expected inputs that are certain; received none."),
}


def _realisations(
    kind: str, part: States | Costates | Switching, name: str | None, units: Mapping[str, str] = MappingProxyType({})
) -> "Figure":
    """A state, a costate or a switching function over time; by default the first."""
    title, nothing = _OF_REALISATIONS[kind]
    name, values = chosen(f"plot.{kind}", name, part.values, nothing)
    shown: dict[str, Any] = {"y": title.format(name), "unit": units.get(name, ""), "who": "realisations"}
    if kind == "input":
        values = np.asarray(values)[None]
        shown |= {"who": "switching functions", "limits": {0.0: "an input inside its bounds makes it zero"}}
    return histories_figure(part.times_of(name), values, **shown)


@plots_of.register(States)
class StatesPlots(AbstractPlots[States]):
    """Figures of the states of all realisations."""

    def state(self, name: str | None = None) -> "Figure":
        """A state over time, of every realisation at the collocation points; by default the first."""
        return _realisations("state", self._result, name)


@plots_of.register(Costates)
class CostatesPlots(AbstractPlots[Costates]):
    """Figures of costates."""

    def costate(self, name: str | None = None) -> "Figure":
        """The costate of a state over time, of every realisation at the collocation points; by default the first."""
        return _realisations("costate", self._result, name)


@plots_of.register(Switching)
class SwitchingPlots(AbstractPlots[Switching]):
    """Figures of switching functions."""

    def input(self, name: str | None = None) -> "Figure":
        """The switching function of an input over time, with its zero; by default of the first."""
        return _realisations("input", self._result, name)


_NO_PATH = (
    "expected a path in the objective or in a limit, such as al.path('x'); received a problem without one. "
    "plot.histories simulates any output."
)
_NO_OUTPUT = "expected a system with outputs; received one without."
# The limits over time that one figure has room for.
_LIMITS = 6
_SIMULATED = "expected a solution by al.Simultaneous(); received one whose states were simulated: see plot.histories."


@plots_of.register(Solution)
class SolutionPlots(AbstractPlots[Solution]):
    """Figures of a solution."""

    def __call__(self) -> "Figure":
        """The design in one figure: the inputs that it decides over time, what is limited over time with its limits,
        active ones first, and where the decisions lie between their bounds.

        At most six limits over time are drawn; without any, the first path in the problem.
        """
        limited = self._limited() or ([self.band()] if paths_of(self._result.problem) else [])
        parts = [*self._inputs(), *limited]
        return stacked([*parts, self.decisions()] if self._between_bounds() or not parts else parts)

    def band(self, output: str | None = None, *, sigmas: float | None = None) -> "Figure":
        """The mean of a path over time with the band of `sigmas` standard deviations about it, and its limits.

        - `output`: of a path in the problem, by default one with an active limit, else the first; `sigmas`: by default
          as in its limits, else 2.
        """
        problem, known = self._result.problem, paths_of(self._result.problem)
        if known and output is not None and not (isinstance(output, str) and output in known):
            raise ProblemError(f"{unknown('plot.band', output, known)} plot.histories simulates any other output.")
        name, functional = chosen("plot.band", self._held_path() if output is None else output, known, _NO_PATH)
        limits, moments = limits_of(problem, functional), self._result.moments[functional.text()]
        return path_figure(
            self._result.times_of(functional),
            components(f"mean of {name}", moments.mean, moments.std),
            sigmas=limits.sigmas if sigmas is None else positive("plot.band: sigmas", sigmas),
            y=name,
            unit=limits.unit,
            limits=limits.texts,
            title=self._warning(),
        )

    def histories(self, output: str | None = None, *, samples: int = 50, seed: int = 0) -> "Figure":
        """Any output of the system over time, simulated anew on random systems, with its limits; or an input or a
        state, in the systems of the expansion.

        - `output`: by default that of a path with an active limit, else of the first path in the problem, else the
          first of the system; `samples`: how many systems, drawn from `seed`; a system of which nothing is uncertain is
          simulated once.
        """
        problem, paths = self._result.problem, paths_of(self._result.problem)
        samples, seed = whole("plot.histories: samples", samples), whole("plot.histories: seed", seed, least=0)
        usual = paths.get(self._held_path() or next(iter(paths), ""))
        output = usual.output if output is None and usual is not None else output
        name, kind = chosen("plot.histories", output, _over_time(self._result), _NO_OUTPUT)
        unit, is_random = units_of_outputs(problem).get(name, ""), kind == "outputs" and bool(problem.placements.germs)
        motions = simulate_systems(self._result, samples, seed=seed) if is_random else getattr(self._result, kind)
        limited = paths.get(name)
        limits = {} if limited is None or limited.output != name else limits_of(problem, limited).texts
        who = "random systems" if is_random else "systems"
        shown = {"unit": unit, "limits": limits, "title": self._warning(), "who": who}
        return histories_figure(np.asarray(motions.times_of(name)), motions.systems[name], y=name, **shown)

    def limit(self, name: str | None = None) -> "Figure":
        """What a limit over time is on (such as mean + 2 σ), its bounds, and where it is active; by default the one
        that is active, else the first.
        """
        every = zip(self._result.constraints, self._result.problem.constraints, strict=True)
        pairs = [(one, declared) for one, declared in every if one.times is not None]
        over_time = {one.name: declared.expression for one, declared in pairs}
        nothing, first = "expected a limit over time; received a problem without one.", next(iter(self._active()), None)
        name, expression = chosen("plot.limit", first if name is None else name, over_time, nothing)
        unit = unit_of_expression(expression, self._result.problem)
        # Both sides of a limit, or limits on several paths, may have one name.
        named = [(one, str(declared.expression)) for one, declared in pairs if one.name == name]
        times = np.asarray(named[0][0].times)
        parts = [(one, text) for one, text in named if np.array_equal(np.asarray(one.times), times)]
        lines = [components(text, one.values, np.zeros_like(one.values)) for one, text in parts]
        bounds = [bound for one, _ in parts for bound in (one.lower, one.upper)]
        shown = {"unit": unit, "limits": limits_text(bounds, unit), "title": self._warning()}
        figure = path_figure(times, {text: one for line in lines for text, one in line.items()}, y=name, **shown)
        active = [np.reshape(one.active, (len(times), -1)) for one, _ in parts]
        values = [np.reshape(one.values, part.shape)[part] for (one, _), part in zip(parts, active, strict=True)]
        places = [np.repeat(times, part.sum(axis=1)) for part in active]
        marks = {"name": "active", "mode": "markers", "hover": "active at %{x:.4~g} s", "marker_size": 8}
        draw(figure, np.concatenate(places), np.concatenate(values), ALARM, **marks)
        return figure

    def decisions(self) -> "Figure":
        """Each decision between its bounds, in percent of the way from the lower to the upper one, with where it began.

        An array of decisions has one marker for each entry. Decisions without two finite bounds have no such place.
        """
        solution, shown = self._result, self._between_bounds()
        if not shown:
            known = list(solution.problem.placements.designed)
            raise ProblemError(f"plot.decisions: expected a decision with two finite bounds; received {known} without.")
        figure = blank(label("Way from the lower to the upper bound", "%"), "", height=130 + 44 * len(shown))
        look = looks(["design"])["design"]
        for row, (name, one) in enumerate(shown.items()):
            low, wide = np.asarray(one.lower, float), np.subtract(one.upper, one.lower)
            unit, value, place = unit_of_decision(name, solution.problem), solution.decisions[name], plain(name)
            draw(figure, [0, 100], [place] * 2, MUTED, mode="lines", line_width=1, showlegend=False)
            rows = (("start", one.initial, Look(MUTED, f"{look.symbol}-open")), ("design", value, look))
            for kind, values, each in rows:
                ways = np.ravel(100 * (np.asarray(values, float) - low) / np.where(wide > 0, wide, 1.0))
                texts = [number(entry, 5, plain(unit)) for entry in np.ravel(values)]
                named = {"name": kind, "legendgroup": kind, "showlegend": row == 0, "text": texts}
                hover = f"<b>{place}</b>, {kind}: %{{text}}"
                draw(figure, ways, [place] * len(ways), each, mode="markers", hover=hover, cliponaxis=False, **named)
            sentence = f"{number(float(value), 5, unit)}, " if np.ndim(value) == 0 else ""
            sentence += f"between {given(float(np.min(one.lower)))} and {given(float(np.max(one.upper)), unit)}"
            above = {"xanchor": "right", "yanchor": "bottom", "yshift": 9, "showarrow": False}
            figure.add_annotation(
                x=100, y=place, text=plain(sentence), font={"size": SIZE - 2, "color": LIMIT}, **above
            )
        figure.update_xaxes(range=[-4, 104])
        return figure.update_yaxes(type="category", range=[len(shown) - 0.5, -0.7], showgrid=False)

    def input(self, name: str | None = None) -> "Figure":
        """An input over time, with the band of two standard deviations about its mean; by default the first."""
        inputs = dict.fromkeys(self._result.problem.inputs, "")
        name, _ = chosen("plot.input", name, inputs, "expected a problem with inputs; received one without.")
        return motion_figure(self._result.inputs, name, title=self._warning())

    def state(self, name: str | None = None) -> "Figure":
        """A state over time, of all realisations of a simultaneous program."""
        units = units_of_outputs(self._result.problem)
        return _realisations("state", _collocated(self._result.mesh_states, "plot.state"), name, units)

    def costate(self, name: str | None = None) -> "Figure":
        """The costate of a state over time, of all realisations of a simultaneous program."""
        return _realisations("costate", _collocated(self._result.costates, "plot.costate"), name)

    def switching(self, name: str | None = None) -> "Figure":
        """The switching function of an input over time, of a simultaneous program."""
        return _realisations("input", _collocated(self._result.switching, "plot.switching"), name)

    def mesh(self) -> "Figure":
        """The meshes of a simultaneous program, with their errors."""
        meshes = self._result.meshes
        return mesh_figure(_collocated(meshes if any(one.worst for one in meshes) else None, "plot.mesh"))

    def search(self) -> "Figure":
        """What a search without derivatives evaluated, or the local solver where there was none."""
        searched = self._result.effort.searched or self._result.effort.visited
        return search_figure(searched, unit_of_objective(self._result.problem))

    def _active(self) -> list[str]:
        """The limits over time that are active."""
        return [one.name for one in self._result.constraints if one.times is not None and np.any(one.active)]

    def _inputs(self) -> "Iterator[Figure]":
        """The inputs that are decided, those of one unit and phase together."""
        names = [name for name, one in self._result.problem.inputs.items() if placements(one).decisions]
        if names:
            motions = self._result.inputs
            alike = dict[Any, list[str]]()
            for name in names:
                unit, times = motions.units.get(name) or name, np.asarray(motions.times_of(name))
                alike.setdefault((unit, times.tobytes()), []).append(name)
            for each in alike.values():
                yield motion_figure(motions, *each, title=self._warning())

    def _limited(self) -> "list[Figure]":
        """The limits over time, each by its path where it is on one alone; active ones first."""
        problem, active = self._result.problem, set(self._active())
        alone = {path: limits_of(problem, one).names for path, one in paths_of(problem).items()}
        over_time = dict.fromkeys(one.name for one in self._result.constraints if one.times is not None)
        every = [(self.band, path, bool(names & active)) for path, names in alone.items() if names]
        every += [(self.limit, name, name in active) for name in over_time if name not in set().union(*alone.values())]
        return [figure(name) for figure, name, _ in sorted(every, key=lambda one: not one[2])[:_LIMITS]]

    def _between_bounds(self) -> dict[str, AbstractDecision]:
        """The decisions that have two finite bounds."""
        every = self._result.problem.placements.designed.items()
        places = {name: one.decision for name, one in every}
        return {name: one for name, one in places.items() if np.all(np.isfinite(np.subtract(one.upper, one.lower)))}

    def _held_path(self) -> str | None:
        """A path on which alone there is an active limit; None without one."""
        problem, active = self._result.problem, set(self._active())
        paths = paths_of(problem).items()
        return next((name for name, one in paths if limits_of(problem, one).names & active), None)

    def _warning(self) -> str:
        """What a reader must know of a design that is not solved."""
        return "" if self._result.ok else f"Not a design: {status_words(self._result)}"


@plots_of.register(MeshError)
class MeshPlots(AbstractPlots[MeshError]):
    """The figure of one mesh."""

    def mesh(self) -> "Figure":
        """The nodes of the mesh, and the error of each interval."""
        return mesh_figure([self._result])


@facts_of.register(Solution)
def _(solution: Solution) -> Facts:
    table = side_by_side("", {"": {**dict(design_rows(solution)), "Solver": solution.effort.solver}})
    return Facts(f"Solution: {status_words(solution)}", "" if solution.ok else solution.why(), [table])


def _collocated(part: Any, what: str) -> Any:
    """A part that only simultaneous programs have. Raises `ProblemError` if it is missing."""
    if part is None:
        raise ProblemError(f"{what}: {_SIMULATED}")
    return part
