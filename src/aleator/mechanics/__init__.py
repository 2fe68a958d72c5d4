"""Mechanical systems and their forward, inverse and hybrid dynamics. Knows no randomness."""

from aleator.mechanics._bodies import AbstractJoint as AbstractJoint
from aleator.mechanics._bodies import Ball as Ball
from aleator.mechanics._bodies import Body as Body
from aleator.mechanics._bodies import Fixed as Fixed
from aleator.mechanics._bodies import Free as Free
from aleator.mechanics._bodies import Prismatic as Prismatic
from aleator.mechanics._bodies import Revolute as Revolute
from aleator.mechanics._closures import BodyLoad as BodyLoad
from aleator.mechanics._closures import Closure as Closure
from aleator.mechanics._closures import Coupling as Coupling
from aleator.mechanics._dynamics import Actuation as Actuation
from aleator.mechanics._dynamics import ForwardDynamics as ForwardDynamics
from aleator.mechanics._dynamics import HybridDynamics as HybridDynamics
from aleator.mechanics._dynamics import InverseDynamics as InverseDynamics
from aleator.mechanics._dynamics import actuation_of as actuation_of
from aleator.mechanics._equations import Accelerations as Accelerations
from aleator.mechanics._equations import Lagrangian as Lagrangian
from aleator.mechanics._equations import Mechanical as Mechanical
from aleator.mechanics._formulation import AbstractFormulation as AbstractFormulation
from aleator.mechanics._mechanical import AbstractMechanical as AbstractMechanical
from aleator.mechanics._mechanical import Motion as Motion
from aleator.mechanics._multibody import Multibody as Multibody
