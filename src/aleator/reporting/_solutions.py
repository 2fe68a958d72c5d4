"""Figures and facts of solutions: what they decide, over time and between bounds, and how they came about."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from aleator._core.arrays import jax_array
from aleator._core.border import positive, whole
from aleator._core.errors import ProblemError
from aleator.design import history
from aleator.nlp import Searched
from aleator.reporting._numbers import (
    count,
    given,
    number,
    residual,
    unit_of_decision,
    unit_of_objective,
    units_of_outputs,
)
from aleator.reporting._page import Drawing
from aleator.reporting._paths import (
    active_over_time,
    band_figure,
    figures_over_time,
    histories_figure,
    limit_figure,
    limits_of,
    motion_figure,
    path_figure,
    paths_of,
)
from aleator.reporting._showing import AbstractPlots, Facts, chosen, facts_of, plots_of, unknown
from aleator.reporting._style import (
    ALARM,
    LIMIT,
    MUTED,
    SIZE,
    Look,
    blank,
    draw,
    label,
    limit_line,
    looks,
    padded,
    plain,
    short,
    stacked,
)
from aleator.reporting._tables import design_rows, side_by_side, status_words
from aleator.solution import Costates, MeshError, Moments, Solution, States, Switching
from aleator.solving import simulate_systems
from aleator.uncertainty import AbstractDecision, placements

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

_NO_STATE = "expected states that are variables of the program; received a system without states."


@plots_of.register(States)
class StatesPlots(AbstractPlots[States]):
    """Figures of the states of all realisations."""

    def state(self, name: str | None = None, *, units: Mapping[str, str] = MappingProxyType({})) -> "Figure":
        """A state over time, of every realisation at the collocation points; by default the first.

        - `units`: of states, by name.
        """
        name, values = chosen("plot.state", name, self._result.values, _NO_STATE)
        times, unit = self._result.times_of(name), units.get(name, "")
        return histories_figure(times, values, y=name, unit=unit, who="realisations")


@plots_of.register(Costates)
class CostatesPlots(AbstractPlots[Costates]):
    """Figures of costates."""

    def costate(self, name: str | None = None) -> "Figure":
        """The costate of a state over time, of every realisation at the collocation points; by default the first."""
        name, values = chosen("plot.costate", name, self._result.values, _NO_STATE)
        return histories_figure(self._result.times_of(name), values, y=f"Costate of {name}", who="realisations")


@plots_of.register(Switching)
class SwitchingPlots(AbstractPlots[Switching]):
    """Figures of switching functions."""

    def input(self, name: str | None = None) -> "Figure":
        """The switching function of an input over time, with its zero; by default of the first."""
        nothing = "expected inputs that are certain; received none."
        name, values = chosen("plot.input", name, self._result.values, nothing)
        path = {name: Moments(values, np.zeros_like(values))}
        limits, times = {0.0: "an input inside its bounds makes it zero"}, self._result.times_of(name)
        return path_figure(times, path, y=f"Switching function of {name}", limits=limits)


_NO_PATH = (
    "expected a path in the objective or in a limit, such as al.path('x'); received a problem without one. "
    "plot.histories simulates any output."
)
# The limits over time that one figure has room for.
_LIMITS = 6


@plots_of.register(Solution)
class SolutionPlots(AbstractPlots[Solution]):
    """Figures of a solution."""

    def __call__(self) -> "Figure":
        """The design in one figure: the inputs that it decides over time, what is limited over time with its limits,
        active ones first, and where the decisions lie between their bounds.

        At most six limits over time are drawn; without any, the first path in the problem.
        """
        limited, others = figures_over_time(self._result)
        paths = [*limited.values()][:_LIMITS] or [*others.values()][:1]
        parts = [*self._inputs(), *(figure(title=self._warning()) for figure in paths)]
        return stacked([*parts, self.decisions()] if self._between_bounds() or not parts else parts)

    def band(self, output: str | None = None, *, sigmas: float | None = None) -> "Figure":
        """The mean of a path over time with the band of `sigmas` standard deviations about it, and its limits.

        - `output`: of a path in the problem, by default one with an active limit, else the first; `sigmas`: by default
          as in its limits, else 2.
        """
        known = paths_of(self._result.problem)
        if known and output is not None and not (isinstance(output, str) and output in known):
            raise ProblemError(f"{unknown('plot.band', output, known)} plot.histories simulates any other output.")
        name, _ = chosen("plot.band", self._held_path() if output is None else output, known, _NO_PATH)
        sigmas = None if sigmas is None else positive("plot.band: sigmas", sigmas)
        return band_figure(self._result, name, sigmas, self._warning())

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
        nothing = "expected a system with outputs; received one without."
        name, kind = chosen("plot.histories", output, self._over_time(), nothing)
        is_random = kind == "outputs" and bool(problem.placements.germs)
        motions = simulate_systems(self._result, samples, seed=seed) if is_random else getattr(self._result, kind)
        limited = paths.get(name)
        shown: dict[str, Any] = {"who": "random systems" if is_random else "systems", "title": self._warning()}
        if limited is not None and limited.output == name:
            shown["limits"] = limits_of(problem, limited).texts
        unit = units_of_outputs(problem).get(name, "")
        return histories_figure(np.asarray(motions.times_of(name)), motions.systems[name], y=name, unit=unit, **shown)

    def limit(self, name: str | None = None) -> "Figure":
        """What a limit over time is on (such as mean + 2 σ), its bounds, and where it is active; by default the one
        that is active, else the first.
        """
        known = {one.name: one for one in self._result.constraints if one.times is not None}
        nothing, active = "expected a limit over time; received a problem without one.", active_over_time(self._result)
        usual = next((one for one in known if one in active), None)
        return limit_figure(
            self._result, chosen("plot.limit", usual if name is None else name, known, nothing)[0], self._warning()
        )

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
            draw(figure, [0, 100], [place] * 2, MUTED, mode="lines", line_width=1, hover=None, showlegend=False)
            rows = (("start", one.initial, Look(MUTED, f"{look.symbol}-open")), ("design", value, look))
            for kind, values, each in rows:
                ways = np.ravel(100 * (np.asarray(values, float) - low) / np.where(wide > 0, wide, 1.0))
                texts = [f"{place}: {number(entry, 5, plain(unit))}" for entry in np.ravel(values)]
                named = {"name": kind, "legendgroup": kind, "showlegend": row == 0, "text": texts, "mode": "markers"}
                draw(figure, ways, [place] * len(ways), each, hover="%{text}", cliponaxis=False, **named)
            sentence = f"{number(float(value), 5, unit)}, " if np.ndim(value) == 0 else ""
            sentence += f"between {given(float(np.min(one.lower)))} and {given(float(np.max(one.upper)), unit)}"
            above = {"xanchor": "right", "yanchor": "bottom", "yshift": 9, "showarrow": False}
            font = {"size": SIZE - 2, "color": LIMIT}
            figure.add_annotation(x=100, y=place, text=plain(sentence), font=font, **above)
        figure.update_xaxes(range=[-4, 104])
        return figure.update_yaxes(type="category", range=[len(shown) - 0.5, -0.7], showgrid=False)

    def input(self, name: str | None = None) -> "Figure":
        """An input over time, with the band of two standard deviations about its mean; by default the first."""
        inputs = dict.fromkeys(self._result.problem.inputs, "")
        name, _ = chosen("plot.input", name, inputs, "expected a problem with inputs; received one without.")
        return motion_figure(self._result.inputs, name, title=self._warning())

    def state(self, name: str | None = None) -> "Figure":
        """A state over time, of all realisations of a simultaneous program."""
        states = _collocated(self._result.mesh_states, "plot.state")
        return states.plot.state(name, units=units_of_outputs(self._result.problem))

    def costate(self, name: str | None = None) -> "Figure":
        """The costate of a state over time, of all realisations of a simultaneous program."""
        return _collocated(self._result.costates, "plot.costate").plot.costate(name)

    def switching(self, name: str | None = None) -> "Figure":
        """The switching function of an input over time, of a simultaneous program."""
        return _collocated(self._result.switching, "plot.switching").plot.input(name)

    def mesh(self) -> "Figure":
        """The meshes of a simultaneous program, with their errors."""
        meshes = self._result.meshes
        return mesh_figure(_collocated(meshes if any(one.worst for one in meshes) else None, "plot.mesh"))

    def search(self) -> "Figure":
        """What a search without derivatives evaluated, or the local solver where there was none."""
        searched = self._result.effort.searched or self._result.effort.visited
        return search_figure(searched, unit_of_objective(self._result.problem))

    def _over_time(self) -> Mapping[str, str]:
        """Which of the outputs, inputs and states of a system each is, by name. Raises `ProblemError` without time."""
        problem, vector = self._result.problem, jax_array(self._result.vector)
        if not problem.system.has_time:
            raise ProblemError("plot.histories: expected a system that evolves in time; received an algebraic one.")
        germ = jax_array(np.zeros(len(problem.placements.germs)))
        outputs = jax.eval_shape(lambda: history(problem, germ, vector))
        known, states = dict.fromkeys(outputs, "outputs"), getattr(problem.system, "states", ())
        return known | dict.fromkeys(states, "states") | dict.fromkeys(problem.inputs, "inputs") | known

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

    def _between_bounds(self) -> dict[str, AbstractDecision]:
        """The decisions that have two finite bounds."""
        every = self._result.problem.placements.designed.items()
        places = {name: one.decision for name, one in every}
        return {name: one for name, one in places.items() if np.all(np.isfinite(np.subtract(one.upper, one.lower)))}

    def _held_path(self) -> str | None:
        """A path on which alone there is an active limit; None without one."""
        problem, active = self._result.problem, active_over_time(self._result)
        return next((name for name, one in paths_of(problem).items() if limits_of(problem, one).names & active), None)

    def _warning(self) -> str:
        """What a reader must know of a design that is not solved."""
        return "" if self._result.ok else f"Not a design: {status_words(self._result)}"


@plots_of.register(MeshError)
class MeshPlots(AbstractPlots[MeshError]):
    """The figure of one mesh."""

    def mesh(self) -> "Figure":
        """The nodes of the mesh, and the error of each interval."""
        return mesh_figure([self._result])


@plots_of.register(Searched)
class SearchedPlots(AbstractPlots[Searched]):
    """The figure of a search."""

    def search(self) -> "Figure":
        """The objective of every point evaluated, in order, and the best so far."""
        return search_figure(self._result)


@facts_of.register(Solution)
def _(solution: Solution) -> Facts:
    table = side_by_side("", {"": {**dict(design_rows(solution)), "Solver": solution.effort.solver}})
    return Facts(f"Solution: {status_words(solution)}", "" if solution.ok else solution.why(), [table])


def _collocated(part: Any, what: str) -> Any:
    """A part that only simultaneous programs have. Raises `ProblemError` if it is missing."""
    if part is None:
        raise ProblemError(
            f"{what}: expected a solution by al.Simultaneous(); received one whose states were simulated: see "
            "plot.histories."
        )
    return part


# --- How a design came about -----------------------------------------------------------------------------------------

# A point that violates a constraint by more than this, relative to its magnitude, is drawn as one that does not hold.
_HELD = 1e-2
# The axis shows the best values and this part of all others: a few are often far above.
_SHOWN = 0.8
_CAPTION = (
    "Each point is one simulated design; those that violate a constraint by more than one part in a hundred are drawn "
    "as crosses. The line is the best of the others so far, from which derivatives continue."
)


def search_drawings(designs: Mapping[str, Solution]) -> list[Drawing]:
    """The searches for some designs, by their names, for a page: of those that were searched for."""
    searches = {name: (one.effort.searched, unit_of_objective(one.problem)) for name, one in designs.items()}
    return [
        Drawing([search_figure(searched, unit)], f"Search for {name} by {searched.method}", _CAPTION)
        for name, (searched, unit) in searches.items()
        if searched is not None and searched.evaluations
    ]


def search_figure(searched: Searched | None, unit: str = "") -> "Figure":
    """The objective, in its `unit`, of every point that a search evaluated, in order, and the best so far.

    Raises `ProblemError` where there was no search, or none that evaluated anything.
    """
    if searched is None or not searched.evaluations:
        raise ProblemError("plot.search: expected a search, or a solve, that evaluated designs; received none.")
    figure = blank(label("Evaluation"), label("Objective", unit))
    order, held = short(1 + np.arange(searched.evaluations)), searched.violations <= _HELD
    groups = [("feasible", held, Look(MUTED, "circle"))]
    groups += [] if held.all() else [("violates a constraint", ~held, Look(ALARM, "x-thin"))]
    for name, of_kind, look in groups:
        small = {"marker_size": 4, "marker_opacity": 0.5, "marker_line_color": look.colour, "marker_line_width": 1}
        values = short(np.where(of_kind, searched.objectives, np.nan))
        draw(figure, order, values, look, name=name, mode="markers", **small)
    best, look = searched.best(_HELD), looks(["best so far"])["best so far"]
    draw(figure, order, short(best), look, name="best so far", mode="lines", line_shape="hv")
    known = searched.objectives[np.isfinite(searched.objectives)]
    if len(known):
        figure.update_yaxes(range=padded([*known[known <= np.quantile(known, _SHOWN)], *best[np.isfinite(best)]]))
    return figure


# From the first mesh to the last: shades of one hue, so that their order is seen without telling colours apart.
_FIRST, _LAST = np.array((163, 196, 220)), np.array((0, 76, 120))

_NODES = (
    "How far states drift from their equations within each interval, relative to their magnitudes, in the realisation "
    "that is worst there; the marks are the nodes of the mesh."
)
_REFINED = " The last mesh is the darkest. Intervals above the dashed line were divided, or their order was raised."


def mesh_drawing(meshes: Sequence[MeshError], name: str) -> Drawing:
    """The meshes of the design called `name`, for a page."""
    caption = _NODES + _REFINED * (len(meshes) > 1)
    return Drawing([mesh_figure(meshes)], f"Meshes of {name}", caption)


def mesh_figure(meshes: Sequence[MeshError]) -> "Figure":
    """The history of the meshes of a solution: the error of each interval as a step, with marks at the nodes."""
    figure, last = blank(label("Time", "s"), "Drift of the states").update_yaxes(type="log"), meshes[-1]
    for i, mesh in enumerate(meshes):
        way = (i + 1) / len(meshes)
        shade = np.rint((1 - way) * _FIRST + way * _LAST).astype(int).tolist()
        colour, judged = f"rgb({','.join(map(str, shade))})", mesh is last and np.isfinite(mesh.asked)
        verdict = "" if not judged else ", as asked" if mesh.is_met else ", more than asked"
        scheme = "" if i and mesh.scheme == meshes[i - 1].scheme else f" of {mesh.scheme}"
        name = f"Mesh {i + 1}: {count(mesh.intervals)} intervals{scheme}, {residual(mesh.worst)}{verdict}"
        # An error of zero has no place on a logarithmic axis.
        errors = np.where(mesh.errors > 0, mesh.errors, np.nan)
        steps = {"line_shape": "hv", "line_width": 2.0 if mesh is last else 1.3}
        marks = {"marker_size": 7, "marker_line_width": 1, "marker_line_color": colour}
        heights = short(np.append(errors, errors[-1]))
        draw(figure, short(mesh.nodes), heights, Look(colour, "line-ns"), name=name, **steps, **marks)
    if np.isfinite(last.asked):
        limit_line(figure, last.asked, f"{residual(last.asked)} asked")
    return figure.update_layout(showlegend=True)
