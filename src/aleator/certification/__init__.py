"""Checks of an answer: between the instants, on a finer grid, in the worst case, and on fresh systems."""

from aleator.certification._between import held_between as held_between
from aleator.certification._grids import grid_error as grid_error
from aleator.certification._grids import refinement as refinement
from aleator.certification._grids import unconverged as unconverged
from aleator.certification._probe import probed as probed
from aleator.certification._probe import whether_misled as whether_misled
from aleator.certification._reference import Reference as Reference
from aleator.certification._reference import bound_size as bound_size
from aleator.certification._reference import reference as reference
from aleator.certification._reference import reference_factor as reference_factor
from aleator.certification._second_opinion import prepare_judges as prepare_judges
from aleator.certification._second_opinion import second_opinion as second_opinion
from aleator.certification._solution import diagnose as diagnose
from aleator.certification._solution import doubts as doubts
from aleator.certification._solution import moved_correlations as moved_correlations
from aleator.certification._solution import solution_of as solution_of
from aleator.certification._solution import untrusted as untrusted
from aleator.certification._worst_case import REACHED as REACHED
from aleator.certification._worst_case import held_at_worst as held_at_worst
