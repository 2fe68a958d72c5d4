"""Figures and facts of solutions: what they decide, over time and between bounds, and how they came about."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from aleator._core.arrays import jax_array
from aleator._core.border import positive, whole
from aleator._core.errors import ProblemError
from aleator.design import history
from aleator.nlp import Searched
from aleator.reporting._documents import rows_of, solution_document, status_words
from aleator.reporting._numbers import count, given, number, residual, unit_of, unit_of_decision, units_of_outputs
from aleator.reporting._page import Drawing
from aleator.reporting._paths import (
    band_figure,
    components,
    held_path,
    histories_figure,
    limit_figure,
    limits_of,
    motion_figure,
    over_time,
    path_figure,
    paths_of,
)
from aleator.reporting._showing import Facts, chosen, facts_of, figure, unknown
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
from aleator.reporting._tables import designed, side_by_side
from aleator.solution import Costates, MeshError, Solution, States, Switching
from aleator.solving import simulate_systems
from aleator.uncertainty import AbstractDecision, placements

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

_NO_PATH = (
    "expected a path in the objective or in a limit, such as al.path('x'); received a problem without one. "
    "plot.histories simulates any output."
)
# The limits over time that one figure has room for.
_LIMITS = 6


@figure(Solution, "")
def design_figure(solution: Solution) -> "Figure":
    """The design in one figure: the inputs that it decides over time, what is limited over time with its limits, active
    ones first, and where the decisions lie between their bounds.

    At most six limits over time are drawn; without any, the first path in the problem.
    """
    every, warning = over_time(solution), _warning(solution)
    paths = [one for one in every if one.is_limited][:_LIMITS] or every[:1]
    parts = [*_decided_inputs(solution), *(one.draw(title=warning) for one in paths)]
    return stacked([*parts, decisions(solution)] if _between_bounds(solution) or not parts else parts)


@figure(Solution)
def band(solution: Solution, output: str | None = None, *, sigmas: float | None = None) -> "Figure":
    """The mean of a path over time with the band of `sigmas` standard deviations about it, and its limits.

    - `output`: of a path in the problem, by default one with an active limit, else the first; `sigmas`: by default
      as in its limits, else 2.
    """
    known = paths_of(solution.problem)
    if known and output is not None and output not in known:
        raise ProblemError(f"{unknown('plot.band', output, known)} plot.histories simulates any other output.")
    name, _ = chosen("plot.band", held_path(solution) if output is None else output, known, _NO_PATH)
    sigmas = None if sigmas is None else positive("plot.band: sigmas", sigmas)
    return band_figure(solution, name, _warning(solution), sigmas)


@figure(Solution)
def histories(solution: Solution, output: str | None = None, *, samples: int = 50, seed: int = 0) -> "Figure":
    """Any output of the system over time, simulated anew on random systems, with its limits; or an input or a state, in
    the systems of the expansion.

    - `output`: by default that of a path with an active limit, else of the first path in the problem, else the first of
      the system; `samples`: how many systems, drawn from `seed`; a system of which nothing is uncertain is simulated
      once.
    """
    problem, paths = solution.problem, paths_of(solution.problem)
    samples, seed = whole("plot.histories: samples", samples), whole("plot.histories: seed", seed, least=0)
    usual = paths.get(held_path(solution) or next(iter(paths), ""))
    output = usual.output if output is None and usual is not None else output
    nothing = "expected a system with outputs; received one without."
    name, kind = chosen("plot.histories", output, _over_time(solution), nothing)
    is_random = kind == "outputs" and bool(problem.placements.germs)
    motions = simulate_systems(solution, samples, seed=seed) if is_random else getattr(solution, kind)
    limited = paths.get(name)
    shown: dict[str, Any] = {"who": "random systems" if is_random else "systems", "title": _warning(solution)}
    if limited is not None and limited.output == name:
        shown["limits"] = limits_of(problem, limited).texts
    unit = units_of_outputs(problem).get(name, "")
    return histories_figure(np.asarray(motions.times_of(name)), motions.systems[name], y=name, unit=unit, **shown)


@figure(Solution)
def limit(solution: Solution, name: str | None = None) -> "Figure":
    """What a limit over time is on (such as mean + 2 σ), its bounds, and where it is active; by default the one that is
    active, else the first.
    """
    limits = {one.name: bool(np.any(one.active)) for one in solution.constraints if one.times is not None}
    usual = next((one for one, is_active in limits.items() if is_active), None)
    nothing = "expected a limit over time; received a problem without one."
    name, _ = chosen("plot.limit", usual if name is None else name, limits, nothing)
    return limit_figure(solution, name, _warning(solution))


@figure(Solution)
def decisions(solution: Solution) -> "Figure":
    """Each decision between its bounds, in percent of the way from the lower to the upper one, with where it began.

    An array of decisions has one marker for each entry. Decisions without two finite bounds have no such place.
    """
    shown = _between_bounds(solution)
    if not shown:
        known = list(solution.problem.placements.designed)
        raise ProblemError(f"plot.decisions: expected a decision with two finite bounds; received {known} without.")
    drawn = blank(label("Way from the lower to the upper bound", "%"), "", height=130 + 44 * len(shown))
    look = looks(["design"])["design"]
    for row, (name, one) in enumerate(shown.items()):
        low, wide = np.asarray(one.lower, float), np.subtract(one.upper, one.lower)
        unit, value, place = unit_of_decision(name, solution.problem), solution.decisions[name], plain(name)
        draw(drawn, [0, 100], [place] * 2, MUTED, mode="lines", line_width=1, hover=None, showlegend=False)
        for kind, values, each in (("start", one.initial, Look(MUTED, f"{look.symbol}-open")), ("design", value, look)):
            ways = np.ravel(100 * (np.asarray(values, float) - low) / np.where(wide > 0, wide, 1.0))
            texts = [f"{place}: {number(entry, 5, plain(unit))}" for entry in np.ravel(values)]
            named = {"name": kind, "legendgroup": kind, "showlegend": row == 0, "text": texts, "mode": "markers"}
            draw(drawn, ways, [place] * len(ways), each, hover="%{text}", cliponaxis=False, **named)
        sentence = f"{number(float(value), 5, unit)}, " if np.ndim(value) == 0 else ""
        sentence += f"between {given(float(np.min(one.lower)))} and {given(float(np.max(one.upper)), unit)}"
        above = {"xanchor": "right", "yanchor": "bottom", "yshift": 9, "showarrow": False}
        font = {"size": SIZE - 2, "color": LIMIT}
        drawn.add_annotation(x=100, y=place, text=plain(sentence), font=font, **above)
    drawn.update_xaxes(range=[-4, 104])
    return drawn.update_yaxes(type="category", range=[len(shown) - 0.5, -0.7], showgrid=False)


@figure(Solution, "input")
def input_figure(solution: Solution, name: str | None = None) -> "Figure":
    """An input over time, with the band of two standard deviations about its mean; by default the first."""
    inputs = dict.fromkeys(solution.problem.inputs, "")
    name, _ = chosen("plot.input", name, inputs, "expected a problem with inputs; received one without.")
    return motion_figure(solution.inputs, name, title=_warning(solution))


@figure(Solution)
def mesh(solution: Solution) -> "Figure":
    """The meshes of a simultaneous program, with their errors."""
    if not any(one.worst for one in solution.meshes):
        raise ProblemError("plot.mesh: expected a solution by al.Simultaneous(); received one of simulated states.")
    return mesh_figure(solution.meshes)


@figure(Solution)
def search(solution: Solution) -> "Figure":
    """What a search without derivatives evaluated, or the local solver where there was none."""
    searched = solution.effort.searched or solution.effort.visited
    return search_figure(searched, unit_of(solution.problem.objective, solution.problem))


def _over_time(solution: Solution) -> Mapping[str, str]:
    """Which of the outputs, inputs and states of a system each is, by name. Raises `ProblemError` without time."""
    problem, vector = solution.problem, jax_array(solution.vector)
    if not problem.system.has_time:
        raise ProblemError("plot.histories: expected a system that evolves in time; received an algebraic one.")
    germ = jax_array(np.zeros(len(problem.placements.germs)))
    outputs = dict.fromkeys(jax.eval_shape(lambda: history(problem, germ, vector)), "outputs")
    states = dict.fromkeys(getattr(problem.system, "states", ()), "states")
    return outputs | states | dict.fromkeys(problem.inputs, "inputs") | outputs


def _decided_inputs(solution: Solution) -> "list[Figure]":
    """The inputs that are decided, those of one unit and phase together."""
    names = [name for name, one in solution.problem.inputs.items() if placements(one).decisions]
    if not names:
        return []
    motions, alike = solution.inputs, dict[Any, list[str]]()
    for name in names:
        unit, times = motions.units.get(name) or name, np.asarray(motions.times_of(name))
        alike.setdefault((unit, times.tobytes()), []).append(name)
    return [motion_figure(motions, *each, title=_warning(solution)) for each in alike.values()]


def _between_bounds(solution: Solution) -> dict[str, AbstractDecision]:
    """The decisions that have two finite bounds."""
    places = {name: one.decision for name, one in solution.problem.placements.designed.items()}
    return {name: one for name, one in places.items() if np.all(np.isfinite(np.subtract(one.upper, one.lower)))}


def _warning(solution: Solution) -> str:
    """What a reader must know of a design that is not solved."""
    return "" if solution.ok else f"Not a design: {status_words(solution)}"


@facts_of.register(Solution)
def _(solution: Solution) -> Facts:
    table = side_by_side("", {"": {**designed(rows_of(solution_document(solution))), "Solver": solution.effort.solver}})
    return Facts(f"Solution: {status_words(solution)}", "" if solution.ok else solution.why(), [table])


# --- What a simultaneous program has beside its design ---------------------------------------------------------------


@figure(States)
def state(states: States, name: str | None = None) -> "Figure":
    """A state over time, of every realisation at the collocation points; by default the first."""
    name, values = chosen("plot.state", name, states.values, "expected a system with states; received one without.")
    return histories_figure(states.times_of(name), values, y=name, who="realisations")


@figure(Costates)
def costate(costates: Costates, name: str | None = None) -> "Figure":
    """The costate of a state over time, of every realisation at the collocation points; by default the first."""
    name, values = chosen("plot.costate", name, costates.values, "expected a system with states; received one without.")
    return histories_figure(costates.times_of(name), values, y=f"Costate of {name}", who="realisations")


@figure(Switching, "input")
def switching_figure(switching: Switching, name: str | None = None) -> "Figure":
    """The switching function of an input over time, with its zero; by default of the first."""
    name, values = chosen("plot.input", name, switching.values, "expected inputs that are certain; received none.")
    limits, path = {0.0: "an input inside its bounds makes it zero"}, components(name, values)
    return path_figure(switching.times_of(name), path, y=f"Switching function of {name}", limits=limits)


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


@figure(MeshError, "mesh")
def _(mesh: MeshError) -> "Figure":
    """The nodes of the mesh, and the error of each interval."""
    return mesh_figure([mesh])


def mesh_figure(meshes: Sequence[MeshError]) -> "Figure":
    """The history of the meshes of a solution: the error of each interval as a step, with marks at the nodes."""
    drawn, last = blank(label("Time", "s"), "Drift of the states").update_yaxes(type="log"), meshes[-1]
    for i, one in enumerate(meshes):
        way = (i + 1) / len(meshes)
        shade = np.rint((1 - way) * _FIRST + way * _LAST).astype(int).tolist()
        colour, judged = f"rgb({','.join(map(str, shade))})", one is last and np.isfinite(one.asked)
        verdict = "" if not judged else ", as asked" if one.is_met else ", more than asked"
        scheme = "" if i and one.scheme == meshes[i - 1].scheme else f" of {one.scheme}"
        name = f"Mesh {i + 1}: {count(one.intervals)} intervals{scheme}, {residual(one.worst)}{verdict}"
        # An error of zero has no place on a logarithmic axis.
        errors = np.where(one.errors > 0, one.errors, np.nan)
        steps = {"line_shape": "hv", "line_width": 2.0 if one is last else 1.3}
        marks = {"marker_size": 7, "marker_line_width": 1, "marker_line_color": colour}
        heights = short(np.append(errors, errors[-1]))
        draw(drawn, short(one.nodes), heights, Look(colour, "line-ns"), name=name, **steps, **marks)
    if np.isfinite(last.asked):
        limit_line(drawn, last.asked, f"{residual(last.asked)} asked")
    return drawn.update_layout(showlegend=True)


# --- What was searched -----------------------------------------------------------------------------------------------

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
    searches = {name: one for name, one in designs.items() if one.effort.searched and one.effort.searched.evaluations}
    return [
        Drawing([search(one)], f"Search for {name} by {one.effort.searched.method}", _CAPTION)  # type: ignore[union-attr]
        for name, one in searches.items()
    ]


@figure(Searched, "search")
def search_figure(searched: Searched | None, unit: str = "") -> "Figure":
    """The objective, in its `unit`, of every point that a search evaluated, in order, and the best so far.

    Raises `ProblemError` where there was no search, or none that evaluated anything.
    """
    if searched is None or not searched.evaluations:
        raise ProblemError("plot.search: expected a search, or a solve, that evaluated designs; received none.")
    drawn = blank(label("Evaluation"), label("Objective", unit))
    order, held = short(1 + np.arange(searched.evaluations)), searched.violations <= _HELD
    groups = [("feasible", held, Look(MUTED, "circle"))]
    groups += [] if held.all() else [("violates a constraint", ~held, Look(ALARM, "x-thin"))]
    for name, of_kind, look in groups:
        small = {"marker_size": 4, "marker_opacity": 0.5, "marker_line_color": look.colour, "marker_line_width": 1}
        values = short(np.where(of_kind, searched.objectives, np.nan))
        draw(drawn, order, values, look, name=name, mode="markers", **small)
    best, look = searched.best(_HELD), looks(["best so far"])["best so far"]
    draw(drawn, order, short(best), look, name="best so far", mode="lines", line_shape="hv")
    known = searched.objectives[np.isfinite(searched.objectives)]
    if len(known):
        drawn.update_yaxes(range=padded([*known[known <= np.quantile(known, _SHOWN)], *best[np.isfinite(best)]]))
    return drawn
