"""From a declared problem to a nonlinear program."""

from aleator.transcription._ahead import prepare_judges as prepare_judges
from aleator.transcription._between import excess_between as excess_between
from aleator.transcription._diagnosis import diagnose as diagnose
from aleator.transcription._evaluator import EVALUATE as EVALUATE
from aleator.transcription._held import held_between as held_between
from aleator.transcription._probe import probed as probed
from aleator.transcription._probe import whether_misled as whether_misled
from aleator.transcription._quality import doubts as doubts
from aleator.transcription._quality import untrusted as untrusted
from aleator.transcription._reference import Reference as Reference
from aleator.transcription._reference import grid_error as grid_error
from aleator.transcription._reference import reference as reference
from aleator.transcription._reference import reference_factor as reference_factor
from aleator.transcription._refinement import refinement as refinement
from aleator.transcription._refinement import unconverged as unconverged
from aleator.transcription._resolution import Resolved as Resolved
from aleator.transcription._second_opinion import second_opinion as second_opinion
from aleator.transcription._sequential import Sequential as Sequential
from aleator.transcription._sequential import compile_seconds as compile_seconds
from aleator.transcription._sequential import transcribe as transcribe
from aleator.transcription._settled import refuse_blind as refuse_blind
from aleator.transcription._solution import solution_of as solution_of
from aleator.transcription._warm_start import started_from as started_from
from aleator.transcription._worst_case import held_at_worst as held_at_worst
