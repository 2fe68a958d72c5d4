"""Simultaneous transcription: direct collocation, the states of every realisation being variables of the program."""

from aleator.transcription.simultaneous._simultaneous import Simultaneous as Simultaneous
