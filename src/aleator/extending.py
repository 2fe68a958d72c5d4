"""Base classes for your own distributions, statistics, functionals, controllers, solvers, transcriptions and studies.

See `docs/extending.md`.

    from aleator import extending as ext

Signals, trajectories and covariances of your own derive from `al.AbstractSignal`, `al.AbstractTrajectory` and
`al.processes.AbstractCovariance`.
"""

from aleator._core.border import Progress as Progress
from aleator._core.leaves import Drawn as Drawn
from aleator._core.leaves import Printed as Printed
from aleator.cli import run_study as run_study
from aleator.design import AbstractFunctional as AbstractFunctional
from aleator.design import AbstractIntegral as AbstractIntegral
from aleator.design import Taken as Taken
from aleator.expansion import Basis as Basis
from aleator.feedback import AbstractController as AbstractController
from aleator.feedback import Plan as Plan
from aleator.journalling import kept as kept
from aleator.nlp import AbstractLocalSolver as AbstractLocalSolver
from aleator.nlp import AbstractSearch as AbstractSearch
from aleator.nlp import Answer as Answer
from aleator.nlp import Evaluation as Evaluation
from aleator.nlp import Multipliers as Multipliers
from aleator.nlp import NonlinearProgram as NonlinearProgram
from aleator.nlp import ScaledProgram as ScaledProgram
from aleator.nlp import Sought as Sought
from aleator.reporting import Code as Code
from aleator.reporting import Drawing as Drawing
from aleator.reporting import Schematic as Schematic
from aleator.reporting import Section as Section
from aleator.reporting import Table as Table
from aleator.reporting import Text as Text
from aleator.reporting import Verdict as Verdict
from aleator.reporting import recommendation as recommendation
from aleator.reporting import save as save
from aleator.statistics import AbstractStatistic as AbstractStatistic
from aleator.studies import AbstractStudy as AbstractStudy
from aleator.studies import Draft as Draft
from aleator.transcription import AbstractTranscribed as AbstractTranscribed
from aleator.transcription import AbstractTranscription as AbstractTranscription
from aleator.transcription import Meaning as Meaning
from aleator.transcription import Scenarios as Scenarios
from aleator.uncertainty import AbstractDistribution as AbstractDistribution
from aleator.uncertainty import AbstractGerm as AbstractGerm
from aleator.uncertainty import Canonical as Canonical
from aleator.uncertainty import Form as Form
from aleator.uncertainty import HermiteGerm as HermiteGerm
from aleator.uncertainty import JacobiGerm as JacobiGerm
from aleator.uncertainty import LaguerreGerm as LaguerreGerm
from aleator.uncertainty import LegendreGerm as LegendreGerm
