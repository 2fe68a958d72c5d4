"""From a declared problem to a nonlinear program."""

from aleator.transcription._abstract import AbstractTranscribed as AbstractTranscribed
from aleator.transcription._abstract import AbstractTranscription as AbstractTranscription
from aleator.transcription._abstract import Meaning as Meaning
from aleator.transcription._constraints import as_read as as_read
from aleator.transcription._constraints import blind_decisions as blind_decisions
from aleator.transcription._constraints import bound_size as bound_size
from aleator.transcription._constraints import refuse_blind as refuse_blind
from aleator.transcription._expansions import RESPOND as RESPOND
from aleator.transcription._expansions import Discretised as Discretised
from aleator.transcription._expansions import Resolved as Resolved
from aleator.transcription._expansions import scope_of as scope_of
from aleator.transcription._scenarios import Scenarios as Scenarios
from aleator.transcription._scenarios import germ_box as germ_box
from aleator.transcription._transcribe import DEFAULT as DEFAULT
from aleator.transcription._transcribe import transcribe as transcribe
from aleator.transcription._warm_start import started_from as started_from
from aleator.transcription.sequential import Sequential as Sequential
from aleator.transcription.sequential import valued_by as valued_by
from aleator.transcription.simultaneous import Simultaneous as Simultaneous
