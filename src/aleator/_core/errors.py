"""The exceptions and warnings of `aleator`.

Each message is one clear sentence (or two) that names the thing, what was expected, what was received and what to do.
"""


class AleatorError(Exception):
    """Base of every error that `aleator` raises on purpose."""


class ProblemError(AleatorError, ValueError):
    """The declared problem is invalid: found before anything is compiled or simulated."""


class SimulationError(AleatorError, ArithmeticError):
    """A simulation produced numbers that are not finite; the message names the realisation and the time."""


class SolveError(AleatorError, RuntimeError):
    """The nonlinear program was not solved. The unfinished solution is kept in `solution`."""

    def __init__(self, message: str, solution: object = None):
        super().__init__(message)
        self.solution = solution


class MissingExtraError(AleatorError, ImportError):
    """An optional library is not installed; the message names the command that installs it."""


class AleatorWarning(UserWarning):
    """Base of every warning that `aleator` issues."""


class ExpansionWarning(AleatorWarning):
    """The expansion does not resolve an output well enough for its statistics to be trusted."""


class CorrelationWarning(AleatorWarning):
    """Uncertain numbers of a design have other correlations than those given, for decisions set their shapes."""


class GridWarning(AleatorWarning):
    """The time grid is too coarse for the accuracy that is asked for."""


class SimulationWarning(AleatorWarning):
    """Outputs of a simulation are not finite, or samples of a black box were dropped; the message names the first."""


class CalibrationWarning(AleatorWarning):
    """A calibration ended without a design whose frequency of violation was confirmed to be low enough."""


class JournalWarning(AleatorWarning):
    """A result cannot be kept in a journal, or one that was kept cannot be used."""
