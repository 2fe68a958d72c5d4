"""From a declared problem to a nonlinear program."""

from aleator.transcription._diagnosis import diagnose as diagnose
from aleator.transcription._resolution import Resolved as Resolved
from aleator.transcription._sequential import EVALUATE as EVALUATE
from aleator.transcription._sequential import Sequential as Sequential
from aleator.transcription._sequential import compile_seconds as compile_seconds
from aleator.transcription._sequential import transcribe as transcribe
