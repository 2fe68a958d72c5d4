"""`Simultaneous`: direct collocation, from a declared problem to its sparse program."""

from dataclasses import dataclass, field
from typing import ClassVar, final

import numpy as np
from typing_extensions import override

from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled
from aleator._core.errors import ProblemError
from aleator._core.given import one_of, positive
from aleator.design import Problem, integrated_paths
from aleator.dynamics import AbstractScheme, Grid, HermiteSimpson
from aleator.nlp import AbstractSolver, Ipopt
from aleator.transcription._abstract import AbstractTranscription, Meanwhile
from aleator.transcription._discretisation import discretised
from aleator.transcription._scenarios import first_scenarios
from aleator.transcription.simultaneous._mesh import Mesh
from aleator.transcription.simultaneous._mesh_error import BETWEEN
from aleator.transcription.simultaneous._program import CURVE, EVALUATE
from aleator.transcription.simultaneous._signals import ALONG
from aleator.transcription.simultaneous._start import SIMULATED
from aleator.transcription.simultaneous._transcribed import TOLD, SimultaneouslyTranscribed, Way

# The least error of a mesh that may be asked for.
_LEAST_ERROR = 1e-12


@final
@dataclass(frozen=True)
class Simultaneous(AbstractTranscription):
    """States are variables of the program, and a collocation scheme holds them to the dynamics: direct collocation.

    The way for long, unstable or stiff systems and for limits on states. Its programs are large and sparse, with exact
    second derivatives, and solved by interior points.

    - `scheme`: how states follow their rates, such as `al.schemes.Radau(3)`;
    - `error`: the error of the states that is asked of every interval of the mesh, relative to their magnitudes. The
      mesh begins as the steps of the grid; intervals that err more are divided until all are as accurate. None leaves
      it as it is.

    Raises `ProblemError` for an algebraic system, and for statistics that are integrated over time.
    """

    scheme: AbstractScheme = field(default_factory=HermiteSimpson)
    error: float | None = None

    programs: ClassVar[tuple[Compiled, ...]] = (EVALUATE, CURVE, SIMULATED, ALONG, TOLD, BETWEEN)

    def __post_init__(self) -> None:
        one_of("Simultaneous: scheme", self.scheme, AbstractScheme, "al.schemes.HermiteSimpson()")
        if self.error is not None and not _LEAST_ERROR <= positive("Simultaneous: error", self.error) < 1:
            raise ProblemError(
                f"Simultaneous: error: expected {_LEAST_ERROR:g} (64-bit arithmetic gives no more) to below 1; "
                f"received {self.error!r}."
            )

    @property
    @override
    def refines(self) -> bool:
        return self.error is not None

    @property
    @override
    def solver(self) -> AbstractSolver:
        return Ipopt()

    @override
    def transcribed(self, problem: Problem, meanwhile: Meanwhile) -> SimultaneouslyTranscribed:
        _refuse(problem)
        scenarios, traced = first_scenarios(problem), numbers_to_arrays(problem)
        found = discretised(problem).at_scenarios(scenarios)
        meanwhile(problem, found)
        assert isinstance(problem.grid, Grid)
        mesh = Mesh(tuple(problem.grid.fractions.tolist()), self.scheme)
        accuracy = np.inf if self.error is None else float(self.error)
        return Way(problem, traced, found, scenarios, accuracy).transcribed(mesh)


def _refuse(problem: Problem) -> None:
    if not isinstance(problem.grid, Grid):
        raise ProblemError(
            f"al.Simultaneous ties states over time: expected a system that moves in time; received "
            f"{type(problem.system).__name__}, which is algebraic. Use al.Sequential()."
        )
    if integrated_paths(problem.expressions):
        raise ProblemError(
            "al.Simultaneous does not take statistics that are integrated over time (al.time_integral, "
            "al.objectives.coefficient_power): use al.Sequential(), or the statistic of an integral."
        )
