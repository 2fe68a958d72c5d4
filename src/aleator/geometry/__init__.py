"""Signed distances between shapes, for collision constraints. Knows no randomness."""

from aleator.geometry._distances import distance as distance
from aleator.geometry._distances import link_distances as link_distances
from aleator.geometry._distances import smallest as smallest
from aleator.geometry._shapes import AbstractShape as AbstractShape
from aleator.geometry._shapes import Box as Box
from aleator.geometry._shapes import Capsule as Capsule
from aleator.geometry._shapes import HalfSpace as HalfSpace
from aleator.geometry._shapes import Sphere as Sphere
