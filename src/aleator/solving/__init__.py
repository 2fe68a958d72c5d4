"""Solutions of design problems."""

from aleator.solving._motions import simulate_systems as simulate_systems
from aleator.solving._solve import Call as Call
from aleator.solving._solve import check_search as check_search
from aleator.solving._solve import solve as solve
