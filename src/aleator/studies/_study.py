"""`AbstractStudy`: what a case study offers to the command line."""

import abc
from collections.abc import Mapping
from pathlib import Path

from aleator._core.progress import Progress
from aleator.reporting import Table


class AbstractStudy(abc.ABC):
    """A case study that runs in stages and keeps what it has finished.

    Stages are run in order; after each of them, and after an interruption or a failure, `save` and `write_page` work
    with what there is.
    """

    @property
    @abc.abstractmethod
    def stages(self) -> Mapping[str, float]:
        """The stages by name, in order, and roughly how long each takes compared with the others."""

    @abc.abstractmethod
    def run(self, stage: str, progress: Progress) -> None:
        """Run one stage and keep its results."""

    @abc.abstractmethod
    def save(self, folder: Path) -> list[Path]:
        """Write all finished results as netCDF and JSON files; returns their paths."""

    @abc.abstractmethod
    def write_page(self, folder: Path) -> Path:
        """Write the report of all finished results; returns its path."""

    @abc.abstractmethod
    def tables(self) -> list[Table]:
        """The tables to print at the end."""

    @abc.abstractmethod
    def headline(self) -> str:
        """The verdict in a sentence."""
