"""Run folders: every finished result is kept at once, so that the same command goes on where a run was ended."""

from aleator.journalling._journal import Journal as Journal
from aleator.journalling._journal import journal as journal
from aleator.journalling._journal import kept as kept
from aleator.journalling._journal import load as load
from aleator.journalling._journal import recalling as recalling
from aleator.journalling._results import FILE as FILE
from aleator.journalling._results import Entry as Entry
