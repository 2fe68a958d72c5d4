"""Checks of an answer: between the instants, on a finer grid, in the worst case, and on fresh systems."""

from aleator.certification._judgement import diagnose as diagnose
