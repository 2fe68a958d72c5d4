"""What other parts use of transcriptions; see `__init__.py`. Modules are loaded at their first use."""

from ._abstract import AbstractTranscribed as AbstractTranscribed
from ._abstract import AbstractTranscription as AbstractTranscription
from ._abstract import Meaning as Meaning
from ._abstract import Remembered as Remembered
from ._constraints import NOISE as NOISE
from ._constraints import OF_ROUNDING as OF_ROUNDING
from ._constraints import as_read as as_read
from ._constraints import blind_decisions as blind_decisions
from ._constraints import bound_size as bound_size
from ._constraints import excess_of as excess_of
from ._constraints import refuse_blind as refuse_blind
from ._constraints import rows_by_name as rows_by_name
from ._discretised import Discretised as Discretised
from ._discretised import Scenarios as Scenarios
from ._discretised import divided as divided
from ._discretised import germ_box as germ_box
from ._expansions import ExpansionScope as ExpansionScope
from ._expansions import Resolved as Resolved
from ._expansions import Terms as Terms
from ._expansions import scope_from as scope_from
from ._transcribe import DEFAULT as DEFAULT
from ._transcribe import transcribe as transcribe
from ._warm_start import started_from as started_from
from .sequential import Sequential as Sequential
from .sequential import valued_by as valued_by
from .simultaneous import Simultaneous as Simultaneous
