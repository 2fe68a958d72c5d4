"""Uncertainty analysis without a design: expansions of any function, Galerkin, elements, tolerances."""

from aleator.analysis._abstract_expanded import AbstractExpanded as AbstractExpanded
from aleator.analysis._expand import expand as expand
from aleator.analysis._expand import fresh_points as fresh_points
from aleator.analysis._expanded import ElementExpanded as ElementExpanded
from aleator.analysis._expanded import Expanded as Expanded
from aleator.analysis._galerkin import galerkin as galerkin
from aleator.analysis._over_intervals import Bounds as Bounds
from aleator.analysis._over_intervals import OverIntervals as OverIntervals
from aleator.analysis._tolerance import Contribution as Contribution
from aleator.analysis._tolerance import ToleranceAnalysis as ToleranceAnalysis
from aleator.analysis._tolerance import Zone as Zone
from aleator.analysis._tolerance import check_limits as check_limits
from aleator.analysis._tolerance import tolerance_analysis as tolerance_analysis
from aleator.analysis._tolerance import zones_of as zones_of
