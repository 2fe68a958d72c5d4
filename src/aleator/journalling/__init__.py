"""Run folders: every finished result is kept at once, so that the same command goes on where a run was ended."""

from aleator.journalling._entry import State as State
from aleator.journalling._journal import FILE as FILE
from aleator.journalling._journal import forget as forget
from aleator.journalling._journal import journal as journal
from aleator.journalling._load import Loaded as Loaded
from aleator.journalling._load import load as load
