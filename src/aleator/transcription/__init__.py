"""From a declared problem to a nonlinear program."""

from aleator.transcription._between import Excess as Excess
from aleator.transcription._between import excess_between as excess_between
from aleator.transcription._between import margins_for as margins_for
from aleator.transcription._between import no_margins as no_margins
from aleator.transcription._between import tightened as tightened
from aleator.transcription._diagnosis import diagnose as diagnose
from aleator.transcription._resolution import Resolved as Resolved
from aleator.transcription._sequential import EVALUATE as EVALUATE
from aleator.transcription._sequential import Sequential as Sequential
from aleator.transcription._sequential import compile_seconds as compile_seconds
from aleator.transcription._sequential import transcribe as transcribe
