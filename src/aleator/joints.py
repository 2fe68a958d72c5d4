"""How a body of `al.Multibody` moves beside its parent, and how loops of bodies are closed."""

from aleator.mechanics import AbstractJoint as AbstractJoint
from aleator.mechanics import Ball as Ball
from aleator.mechanics import Closure as Closure
from aleator.mechanics import Coupling as Coupling
from aleator.mechanics import Fixed as Fixed
from aleator.mechanics import Free as Free
from aleator.mechanics import Prismatic as Prismatic
from aleator.mechanics import Revolute as Revolute
