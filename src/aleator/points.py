"""Germ points at which an expansion is sampled: `al.Expansion(order, points=al.points.SobolPoints())`."""

from aleator.expansion import AbstractPoints as AbstractPoints
from aleator.expansion import ChristoffelPoints as ChristoffelPoints
from aleator.expansion import GaussPoints as GaussPoints
from aleator.expansion import HaltonPoints as HaltonPoints
from aleator.expansion import HammersleyPoints as HammersleyPoints
from aleator.expansion import InducedPoints as InducedPoints
from aleator.expansion import LatinHypercubePoints as LatinHypercubePoints
from aleator.expansion import Nodes as Nodes
from aleator.expansion import OptimalPoints as OptimalPoints
from aleator.expansion import RandomPoints as RandomPoints
from aleator.expansion import SmolyakPoints as SmolyakPoints
from aleator.expansion import SobolPoints as SobolPoints
