"""Run folders: every finished result is kept at once, so that the same command goes on where a run was ended."""

from aleator.journalling._entries import FILE as FILE
from aleator.journalling._entries import Entry as Entry
from aleator.journalling._entries import examined as examined
from aleator.journalling._entries import listing as listing
from aleator.journalling._entries import numbered as numbered
from aleator.journalling._journal import Journal as Journal
from aleator.journalling._journal import journal as journal
from aleator.journalling._journal import load as load
from aleator.journalling._journal import recalling as recalling
from aleator.journalling._kept import kept as kept
