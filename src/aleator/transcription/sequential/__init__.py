"""Sequential transcription: the decisions are the program's variables, and every evaluation simulates the model."""

from aleator.transcription.sequential._evaluator import EVALUATE as EVALUATE
from aleator.transcription.sequential._population import valued_by as valued_by
from aleator.transcription.sequential._transcribed import Sequential as Sequential
