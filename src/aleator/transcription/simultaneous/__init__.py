"""Simultaneous transcription: direct collocation, the states of every realisation being variables of the program."""

from aleator.transcription.simultaneous._transcribed import Simultaneous as Simultaneous
