"""Figures and facts of solutions: paths, histories of simulated systems, decisions, states, costates, switching."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from aleator._core.arrays import numbers_to_arrays
from aleator._core.border import positive, whole
from aleator._core.compilation import Compiled
from aleator._core.errors import ProblemError, SimulationError
from aleator.design import AbstractFunctional, Problem, history, path, responses
from aleator.ensemble import draw
from aleator.reporting._blocks import Table
from aleator.reporting._designs import decisions_figure, mesh_figure, search_figure
from aleator.reporting._numbers import (
    unit_of_expression,
    unit_of_functional,
    unit_of_objective,
    units_of_outputs,
    words,
)
from aleator.reporting._paths import components, histories_figure, limits_of, limits_text, path_figure, paths_of
from aleator.reporting._tables import decision_text, limit_rows, objective_text, status_words
from aleator.reporting.drawn._facts import AbstractPlots, Backend, Facts, chosen, drawn_by, facts_of, plots_of, unknown
from aleator.solution import Costates, MeshError, Solution, States, Switching

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


def _respond(
    problem: Problem, functional: AbstractFunctional, germ: Float[jax.Array, "systems variables"], decisions: jax.Array
) -> Float[jax.Array, "systems instants ..."]:
    return responses(problem, (functional,), germ, decisions)[0]


_RESPOND = Compiled(_respond)


def simulated(solution: Solution, output: str, samples: int, seed: int) -> Float[np.ndarray, "systems instants ..."]:
    """An output of random systems at the decisions of a solution; of the one system where nothing is uncertain.

    Raises `ProblemError` if the code of the system has changed, and `SimulationError` for what is not finite.
    """
    problem = solution.problem
    germs = tuple(problem.placements.germs.values())
    points = draw(germs, samples, np.random.default_rng(seed)) if germs else np.zeros((1, 0))
    found = _RESPOND(numbers_to_arrays(problem), path(output), jnp.asarray(points), jnp.asarray(solution.vector))
    values = np.asarray(found)
    if not np.isfinite(values).all():
        raise SimulationError(
            f"plot.histories: expected finite numbers; '{output}' is not finite on some systems: see al.validate."
        )
    return values


def outputs_of(problem: Problem, solution: Solution) -> Mapping[str, str]:
    """The outputs of a system, by name. Raises `ProblemError` for a system without time."""
    if not problem.system.has_time:
        raise ProblemError("plot.histories: expected a system that evolves in time; received an algebraic one.")
    germ = jnp.zeros(len(problem.placements.germs))
    return dict.fromkeys(jax.eval_shape(lambda: history(problem, germ, jnp.asarray(solution.vector))), "")


_NO_INPUT = "expected inputs that are certain; received none."
_NONE = "expected states that are variables of the program; received a system without states."


def state_figure(states: States, name: str | None, units: Mapping[str, str]) -> "Figure":
    """A state of all realisations over time, with its unit as far as it is known."""
    name, values = chosen("plot.state", name, states.values, _NONE)
    return histories_figure(states.times, values, y=name, unit=units.get(name, ""), who="realisations")


class StatesPlots(AbstractPlots[States]):
    """Figures of the states of all realisations."""

    def state(self, name: str | None = None, *, backend: Backend = "plotly") -> Any:
        """A state over time, of every realisation at the collocation points; by default the first."""
        return drawn_by(backend, state_figure(self._result, name, {}))


plots_of.register(States, StatesPlots)


class CostatesPlots(AbstractPlots[Costates]):
    """Figures of costates."""

    def costate(self, name: str | None = None, *, backend: Backend = "plotly") -> Any:
        """The costate of a state over time, of every realisation at the collocation points; by default the first."""
        name, values = chosen("plot.costate", name, self._result.values, _NONE)
        figure = histories_figure(self._result.times, values, y=f"Costate of {name}", who="realisations")
        return drawn_by(backend, figure)


plots_of.register(Costates, CostatesPlots)


class SwitchingPlots(AbstractPlots[Switching]):
    """Figures of switching functions."""

    def input(self, name: str | None = None, *, backend: Backend = "plotly") -> Any:
        """The switching function of an input over time, with its zero; by default of the first."""
        name, values = chosen("plot.input", name, self._result.values, _NO_INPUT)
        figure = histories_figure(
            self._result.times,
            np.asarray(values)[None],
            y=f"Switching function of {name}",
            who="switching functions",
            limits={0.0: "an input inside its bounds makes it zero"},
        )
        return drawn_by(backend, figure)


plots_of.register(Switching, SwitchingPlots)


_NO_PATH = (
    "expected a path in the objective or in a limit, such as al.path('x'); received a problem without one. "
    "plot.histories simulates any output."
)
_NO_OUTPUT = "expected a system with outputs; received one without."
_SIMULATED = "expected a solution by al.Simultaneous(); received one whose states were simulated: see plot.histories."


class SolutionPlots(AbstractPlots[Solution]):
    """Figures of a solution."""

    def __call__(self, *, backend: Backend = "plotly") -> Any:
        """The band of the first path in the problem; without one, where the decisions lie."""
        return self.band(backend=backend) if paths_of(self._result.problem) else self.decisions(backend=backend)

    def band(self, output: str | None = None, *, sigmas: float | None = None, backend: Backend = "plotly") -> Any:
        """The mean of a path over time with the band of `sigmas` standard deviations about it, and its limits.

        - `output`: of a path in the problem, by default the first; `sigmas`: by default as in its limits, else 2.
        """
        problem, known = self._result.problem, paths_of(self._result.problem)
        if known and output is not None and not (isinstance(output, str) and output in known):
            raise ProblemError(f"{unknown('plot.band', output, known)} plot.histories simulates any other output.")
        name, functional = chosen("plot.band", output, known, _NO_PATH)
        unit = unit_of_functional(functional, problem)
        limits, found = limits_of(problem, functional, unit), self._result.moments[functional.text()]
        figure = path_figure(
            self._result.instants,
            components(f"mean of {name}", found.mean, found.std),
            sigmas=limits.sigmas if sigmas is None else positive("plot.band: sigmas", sigmas),
            y=name,
            unit=unit,
            limits=limits.texts,
            title=self._told(),
        )
        return drawn_by(backend, figure)

    def histories(
        self, output: str | None = None, *, samples: int = 50, seed: int = 0, backend: Backend = "plotly"
    ) -> Any:
        """Any output of the system over time, simulated anew on random systems, with its limits.

        - `output`: by default that of the first path in the problem, else the first of the system; `samples`: how many
          systems, drawn from `seed`; a system of which nothing is uncertain is simulated once.
        """
        problem, paths = self._result.problem, paths_of(self._result.problem)
        samples, seed = whole("plot.histories: samples", samples), whole("plot.histories: seed", seed, least=0)
        outputs = outputs_of(problem, self._result)
        first = next((one.output for one in paths.values()), None)
        name, _ = chosen(
            "plot.histories",
            first if output is None else output,
            outputs,
            _NO_OUTPUT,
        )
        unit = units_of_outputs(problem).get(name, "")
        values = simulated(self._result, name, samples, seed)
        limits = [one for text, one in paths.items() if one.output == name and text == name]
        texts = limits_of(problem, limits[0], unit).texts if limits else {}
        figure = histories_figure(
            self._result.instants, values, y=name, unit=unit, limits=texts, title=self._told(), who="random systems"
        )
        return drawn_by(backend, figure)

    def limit(self, name: str | None = None, *, backend: Backend = "plotly") -> Any:
        """What a limit over time is on (such as mean + 2 σ), its bounds, and where it is active."""
        pairs = zip(self._result.constraints, self._result.problem.constraints, strict=True)
        over_time = {one.name: (one, one.times, declared) for one, declared in pairs if one.times is not None}
        nothing = "expected a limit over time; received a problem without one."
        name, (one, times, declared) = chosen("plot.limit", name, over_time, nothing)
        unit = unit_of_expression(declared.expression, self._result.problem)
        figure = path_figure(
            times,
            components(str(declared.expression), one.values, np.zeros_like(one.values)),
            sigmas=1.0,
            y=name,
            unit=unit,
            limits=limits_text([one.lower, one.upper], unit),
            title=self._told(),
        )
        active = np.reshape(one.active, (len(times), -1))
        figure.add_scatter(
            x=np.repeat(times, active.sum(axis=1)),
            y=np.reshape(one.values, active.shape)[active],
            mode="markers",
            name="active",
            marker={"symbol": "circle", "size": 8, "color": "#8a1c5b"},
        )
        return drawn_by(backend, figure)

    def decisions(self, *, backend: Backend = "plotly") -> Any:
        """Where each decision lies between its bounds, and where it began."""
        return drawn_by(backend, decisions_figure(self._result))

    def state(self, name: str | None = None, *, backend: Backend = "plotly") -> Any:
        """A state over time, of all realisations of a simultaneous program."""
        units = units_of_outputs(self._result.problem)
        return drawn_by(backend, state_figure(_found(self._result.mesh_states, "plot.state"), name, units))

    def costate(self, name: str | None = None, *, backend: Backend = "plotly") -> Any:
        """The costate of a state over time, of all realisations of a simultaneous program."""
        return CostatesPlots(_found(self._result.costates, "plot.costate")).costate(name, backend=backend)

    def switching(self, name: str | None = None, *, backend: Backend = "plotly") -> Any:
        """The switching function of an input over time, of a simultaneous program."""
        return SwitchingPlots(_found(self._result.switching, "plot.switching")).input(name, backend=backend)

    def mesh(self, *, backend: Backend = "plotly") -> Any:
        """The meshes of a simultaneous program, with their errors."""
        meshes = self._result.meshes
        if not any(one.worst for one in meshes):
            raise ProblemError(f"plot.mesh: {_SIMULATED}")
        return drawn_by(backend, mesh_figure(meshes))

    def search(self, *, backend: Backend = "plotly") -> Any:
        """What a search without derivatives evaluated, or the local solver where there was none."""
        searched = self._result.effort.searched or self._result.effort.visited
        if searched is None or not searched.evaluations:
            raise ProblemError("plot.search: expected a solve that evaluated designs; received one without a history.")
        return drawn_by(backend, search_figure(searched, unit_of_objective(self._result.problem)))

    def _told(self) -> str:
        """What a reader must know of a design that is not solved."""
        return "" if self._result.ok else f"Not a design: {status_words(self._result)}"


plots_of.register(Solution, SolutionPlots)


class MeshPlots(AbstractPlots[MeshError]):
    """The figure of one mesh."""

    def mesh(self, *, backend: Backend = "plotly") -> Any:
        """The nodes of the mesh, and the error of each interval."""
        return drawn_by(backend, mesh_figure([self._result]))


plots_of.register(MeshError, MeshPlots)


@facts_of.register(Solution)
def _(solution: Solution) -> Facts:
    heading = f"Solution: {status_words(solution)}"
    rows = [("objective", f"{objective_text(solution)} = {solution.problem.objective}")]
    rows += [(name, decision_text(solution, name)) for name in solution.decisions]
    limits = [(f"limit {name}", text) for name, text in limit_rows(solution)]
    active = [("active", words(list(solution.active), "nothing"))]
    table = Table("", ["", ""], [*rows, *limits, *active, ("solver", solution.effort.solver)])
    return Facts(heading, "" if solution.ok else solution.why(), [table])


def _found(part: Any, what: str) -> Any:
    if part is None:
        raise ProblemError(f"{what}: {_SIMULATED}")
    return part
