"""Models that live elsewhere: black boxes, command lines, and points to be answered by whoever has the model."""

from aleator.foreign._ask import Asked as Asked
from aleator.foreign._ask import ask as ask
from aleator.foreign._black_box import BlackBox as BlackBox
from aleator.foreign._command import Command as Command
from aleator.foreign._isolated import Isolated as Isolated
