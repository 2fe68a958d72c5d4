"""Solutions of design problems."""

from aleator.solving._solve import Call as Call
from aleator.solving._solve import check_search as check_search
from aleator.solving._solve import solve as solve
