"""FMUs that are compiled once for all tests, and the end of the processes that they run in."""

import weakref

import pytest

from aleator.foreign._fmu._fmu import OwnProcess
from rods import rods as rods


@pytest.fixture(autouse=True)
def processes_of_fmus_end(monkeypatch: pytest.MonkeyPatch):
    """End the processes of FMUs with their test: a program that JAX keeps would hold them until the run's end."""
    doors, started = list[weakref.ref[OwnProcess]](), OwnProcess._start

    def noted(door: OwnProcess):
        doors.append(weakref.ref(door))
        return started(door)

    monkeypatch.setattr(OwnProcess, "_start", noted)
    yield
    for door in [reference() for reference in doors]:
        if door is not None:
            door.end()
