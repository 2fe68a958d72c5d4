"""Shapes of bodies and obstacles, and the signed distances between them."""

from aleator.geometry import AbstractShape as AbstractShape
from aleator.geometry import Box as Box
from aleator.geometry import Capsule as Capsule
from aleator.geometry import HalfSpace as HalfSpace
from aleator.geometry import Sphere as Sphere
from aleator.geometry import distance as distance
from aleator.geometry import link_distances as link_distances
from aleator.geometry import smallest as smallest
