"""Figures of histories over time: states, costates, switching functions."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from aleator.reporting._paths import histories_figure
from aleator.reporting.drawn._plots import AbstractPlots, Backend, chosen, drawn_by, plots_of
from aleator.solution import Costates, States, Switching

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

_NO_INPUT = "expected inputs that are certain; received none."
_NONE = "expected states that are variables of the program; received a system without states."


def state_figure(states: States, name: str | None, units: Mapping[str, str]) -> "Figure":
    """A state of all realisations over time, with its unit as far as it is known."""
    name, values = chosen("plot.state", name, states.values, _NONE)
    return histories_figure(states.times, values, y=name, unit=units.get(name, ""), who="realisations")


class StatesPlots(AbstractPlots[States]):
    """Figures of the states of all realisations."""

    def __call__(self, *, backend: Backend = "plotly") -> Any:
        """The first state over time."""
        return self.state(backend=backend)

    def state(self, name: str | None = None, *, backend: Backend = "plotly") -> Any:
        """A state over time, of every realisation at the collocation points; by default the first."""
        return drawn_by(backend, state_figure(self._result, name, {}))


plots_of.register(States, StatesPlots)


class CostatesPlots(AbstractPlots[Costates]):
    """Figures of costates."""

    def __call__(self, *, backend: Backend = "plotly") -> Any:
        """The costate of the first state over time."""
        return self.costate(backend=backend)

    def costate(self, name: str | None = None, *, backend: Backend = "plotly") -> Any:
        """The costate of a state over time, of every realisation at the collocation points; by default the first."""
        name, values = chosen("plot.costate", name, self._result.values, _NONE)
        figure = histories_figure(self._result.times, values, y=f"Costate of {name}", who="realisations")
        return drawn_by(backend, figure)


plots_of.register(Costates, CostatesPlots)


class SwitchingPlots(AbstractPlots[Switching]):
    """Figures of switching functions."""

    def __call__(self, *, backend: Backend = "plotly") -> Any:
        """The switching function of the first input."""
        return self.input(backend=backend)

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
