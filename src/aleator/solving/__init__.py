"""Solutions of design problems."""

from aleator.solving._solve import solve as solve
