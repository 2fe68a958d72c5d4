"""Figures and facts of solutions: what they decide, over time and between bounds, and how they came about."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from aleator._core.arrays import jax_array
from aleator._core.border import positive, whole
from aleator._core.errors import ProblemError
from aleator.design import functionals_of, history
from aleator.nlp import Searched
from aleator.reporting._documents import solution_document, status_words
from aleator.reporting._numbers import given, number, residual, unit_of, unit_of_decision, units_of_outputs
from aleator.reporting._page import Drawing
from aleator.reporting._paths import add_means, components, histories_figure, limits_of, limits_text, paths_of, timeline
from aleator.reporting._showing import Facts, chosen, facts_of, figure
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
    every = over_time(solution)
    paths = [one for one in every if one.is_limited][:_LIMITS] or every[:1]
    parts = [*_decided_inputs(solution), *(one.draw(solution, one.name) for one in paths)]
    return stacked([*parts, decisions(solution)] if _between_bounds(solution) or not parts else parts)


class OverTime(NamedTuple):
    """One figure of a design over time: its name, its active limits, whether it has any, how to draw it."""

    name: str
    active: set[str]
    is_limited: bool
    draw: "Callable[[Solution, str], Figure]"


def over_time(solution: Solution) -> list[OverTime]:
    """The figures of a design over time: what is limited, active limits first; then the other paths in the problem.

    A limit is drawn with its path where it is on one alone.
    """
    problem, paths = solution.problem, paths_of(solution.problem)
    limits = dict.fromkeys(one.name for one in solution.constraints if one.times is not None)
    active = {one.name for one in solution.constraints if one.times is not None and np.any(one.active)}
    alone = {name: limits_of(problem, path).names for name, path in paths.items()}
    together = [name for name in limits if name not in set().union(*alone.values())]
    seen = functionals_of(tuple(one.expression for one in problem.constraints if one.name in together))
    drawn = [(path, names, band) for path, names in alone.items() if names or paths[path] not in seen]
    drawn += [(name, {name}, limit) for name in together]
    every = [OverTime(name, names & active, bool(names), how) for name, names, how in drawn]
    return sorted(every, key=lambda one: (not one.is_limited, not one.active))


def _held_path(solution: Solution) -> str | None:
    """A path on which alone there is an active limit, or else the first path; None without one."""
    paths = paths_of(solution.problem)
    held = (one.name for one in over_time(solution) if one.active and one.name in paths)
    return next(held, next(iter(paths), None))


@figure(Solution)
def band(solution: Solution, output: str | None = None, *, sigmas: float | None = None) -> "Figure":
    """The mean of a path over time with the band of `sigmas` standard deviations about it, and its limits.

    - `output`: of a path in the problem, by default one with an active limit, else the first; `sigmas`: by default
      as in its limits, else 2.
    """
    paths = paths_of(solution.problem)
    name, functional = chosen("plot.band", output or _held_path(solution), paths, _NO_PATH)
    limits, moments = limits_of(solution.problem, functional), solution.moments[functional.text()]
    drawn = timeline(name, limits.unit, limits.texts, _warning(solution))
    sigmas = limits.sigmas if sigmas is None else positive("plot.band: sigmas", sigmas)
    means = components(f"mean of {name}", moments.mean, moments.std)
    return add_means(drawn, solution.times_of(functional), means, sigmas)


@figure(Solution)
def limit(solution: Solution, name: str | None = None) -> "Figure":
    """What a limit over time is on (such as mean + 2 σ), its bounds, and where it is active; by default the one that is
    active, else the first.
    """
    limits = {one.name: bool(np.any(one.active)) for one in solution.constraints if one.times is not None}
    usual = next((one for one, is_active in limits.items() if is_active), None)
    name, _ = chosen("plot.limit", name or usual, limits)
    every = zip(solution.constraints, solution.problem.constraints, strict=True)
    # Both sides of a limit, or limits on several paths, may have one name.
    named = [(one, declared.expression) for one, declared in every if one.name == name and one.times is not None]
    times, unit = np.asarray(named[0][0].times), unit_of(named[0][1], solution.problem)
    parts = [(one, str(text)) for one, text in named if np.array_equal(np.asarray(one.times), times)]
    bounds = limits_text([bound for one, _ in parts for bound in (one.lower, one.upper)], unit)
    drawn = timeline(name, unit, bounds, _warning(solution))
    add_means(drawn, times, {text: line for one, of in parts for text, line in components(of, one.values).items()})
    active = [np.reshape(one.active, (len(times), -1)) for one, _ in parts]
    values = [np.reshape(one.values, where.shape)[where] for (one, _), where in zip(parts, active, strict=True)]
    places = [np.repeat(times, where.sum(axis=1)) for where in active]
    marks = {"name": "active", "mode": "markers", "marker_size": 8}
    draw(drawn, np.concatenate(places), np.concatenate(values), ALARM, **marks)
    return drawn


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
    usual = paths.get(_held_path(solution) or "")
    output = usual.output if output is None and usual is not None else output
    name, kind = chosen("plot.histories", output, _over_time(solution))
    is_random = kind == "outputs" and bool(problem.placements.germs)
    motions = simulate_systems(solution, samples, seed=seed) if is_random else getattr(solution, kind)
    limited = paths.get(name)
    shown: dict[str, Any] = {"who": "random systems" if is_random else "systems", "title": _warning(solution)}
    if limited is not None and limited.output == name:
        shown["limits"] = limits_of(problem, limited).texts
    unit = units_of_outputs(problem).get(name, "")
    return histories_figure(np.asarray(motions.times_of(name)), motions.systems[name], y=name, unit=unit, **shown)


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
    alike, figures = dict[Any, list[str]](), []
    for name in (name for name, one in solution.problem.inputs.items() if placements(one).decisions):
        times = np.asarray(solution.inputs.times_of(name))
        alike.setdefault((solution.inputs.units.get(name) or name, times.tobytes()), []).append(name)
    for names in alike.values():
        motions, moments, means = solution.inputs, solution.inputs.moments, dict[str, Any]()
        for name in names:
            means |= components(name, moments[name].mean, moments[name].std)
        drawn = timeline(", ".join(names), motions.units.get(names[0], ""), title=_warning(solution))
        figures.append(add_means(drawn, np.asarray(motions.times_of(names[0])), means))
    return figures


def _between_bounds(solution: Solution) -> dict[str, AbstractDecision]:
    """The decisions that have two finite bounds."""
    places = {name: one.decision for name, one in solution.problem.placements.designed.items()}
    return {name: one for name, one in places.items() if np.all(np.isfinite(np.subtract(one.upper, one.lower)))}


def _warning(solution: Solution) -> str:
    """What a reader must know of a design that is not solved."""
    return "" if solution.ok else f"Not a design: {status_words(solution)}"


@facts_of.register(Solution)
def _(solution: Solution) -> Facts:
    table = side_by_side("", {"": {**designed(solution_document(solution)), "Solver": solution.effort.solver}})
    return Facts(f"Solution: {status_words(solution)}", "" if solution.ok else solution.why(), [table])


# --- What a simultaneous program has beside its design ---------------------------------------------------------------


@figure(States)
def state(states: States, name: str | None = None) -> "Figure":
    """A state over time, of every realisation at the collocation points; by default the first."""
    name, values = chosen("plot.state", name, states.values)
    return histories_figure(states.times_of(name), values, y=name, who="realisations")


@figure(Costates)
def costate(costates: Costates, name: str | None = None) -> "Figure":
    """The costate of a state over time, of every realisation at the collocation points; by default the first."""
    name, values = chosen("plot.costate", name, costates.values)
    return histories_figure(costates.times_of(name), values, y=f"Costate of {name}", who="realisations")


@figure(Switching, "input")
def switching_figure(switching: Switching, name: str | None = None) -> "Figure":
    """The switching function of an input over time, with its zero; by default of the first."""
    name, values = chosen("plot.input", name, switching.values)
    drawn = timeline(f"Switching function of {name}", limits={0.0: "an input inside its bounds makes it zero"})
    return add_means(drawn, switching.times_of(name), components(name, values))


_NODES = (
    "How far states drift from their equations within each interval, relative to their magnitudes, in the realisation "
    "that is worst there; the marks are the nodes of the mesh. Intervals above the dashed line were divided, or their "
    "order was raised."
)


def mesh_drawing(meshes: Sequence[MeshError], name: str) -> Drawing:
    """The meshes of the design called `name`, for a page."""
    return Drawing([mesh_figure(meshes)], f"Meshes of {name}", _NODES)


@figure(MeshError, "mesh")
def mesh_figure(meshes: Sequence[MeshError] | MeshError) -> "Figure":
    """One mesh, or the meshes of a solution in their order: the error of each interval as a step, with marks at the
    nodes.
    """
    every = [meshes] if isinstance(meshes, MeshError) else list(meshes)
    drawn, asked = timeline("Drift of the states").update_yaxes(type="log"), every[-1].asked
    names = [
        f"Mesh {i}: {one.intervals} intervals of {one.scheme}, {residual(one.worst)}" for i, one in enumerate(every, 1)
    ]
    for one, (name, look) in zip(every, looks(names).items(), strict=True):
        # An error of zero has no place on a logarithmic axis.
        errors = short(np.where(one.errors > 0, one.errors, np.nan))
        marks = {"marker_size": 7, "marker_line_width": 1, "marker_line_color": look.colour, "line_shape": "hv"}
        draw(drawn, short(one.nodes), np.append(errors, errors[-1]), Look(look.colour, "line-ns"), name=name, **marks)
    if np.isfinite(asked):
        limit_line(drawn, asked, f"{residual(asked)} asked")
    return drawn


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
    searches = {name: (one.effort.searched, one.problem) for name, one in designs.items()}
    return [
        Drawing(
            [search_figure(searched, unit_of(problem.objective, problem))],
            f"Search for {name} by {searched.method}",
            _CAPTION,
        )
        for name, (searched, problem) in searches.items()
        if searched is not None and searched.evaluations
    ]


@figure(Searched, "search")
def search_figure(searched: Searched, unit: str = "") -> "Figure":
    """The objective, in its `unit`, of every point that a search evaluated, in order, and the best so far."""
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
