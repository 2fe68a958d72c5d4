"""FMUs that are compiled once for all tests."""

from rods import rods as rods
