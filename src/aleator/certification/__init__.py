"""Checks of an answer: between the instants, on a finer grid, in the worst case, and on fresh systems."""

from aleator.certification._between import held_between as held_between
from aleator.certification._check import Check as Check
from aleator.certification._check import begin_check as begin_check
from aleator.certification._check import check_factor as check_factor
from aleator.certification._check import is_checked as is_checked
from aleator.certification._check import prepare_check as prepare_check
from aleator.certification._grids import grid_error as grid_error
from aleator.certification._grids import misled_at as misled_at
from aleator.certification._grids import refinement as refinement
from aleator.certification._grids import unconverged as unconverged
from aleator.certification._second_opinion import second_opinion as second_opinion
from aleator.certification._solution import diagnose as diagnose
from aleator.certification._solution import doubts as doubts
from aleator.certification._solution import moved_correlations as moved_correlations
from aleator.certification._solution import solution_of as solution_of
from aleator.certification._solution import untrusted as untrusted
from aleator.certification._worst_case import REACHED as REACHED
from aleator.certification._worst_case import held_at_worst as held_at_worst
