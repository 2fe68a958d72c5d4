"""FMUs in processes of their own: what crashes or hangs there ends neither this process nor its work."""

import gc
import os
import pickle
import select
import shutil
import zipfile

import numpy as np
import pytest

import aleator as al
from aleator.foreign._fmu._fmu import _opened_again
from rods import here

pytestmark = pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="processes are watched as Linux does")

GRID = al.Grid(2.0, 4)
ABORTS, LOOPS = 8, 9


def fmu_of(rods, behaviour, *, version=3, **given):
    return al.foreign.Fmu(rods(version), settings={"behaviour": behaviour}, **given)


def process_of(fmu):
    """The number of the process of an FMU."""
    return fmu.door.process.pid


def has_ended(process):
    """Whether a process has ended, or does within some seconds."""
    try:
        handle = os.pidfd_open(process)
    except ProcessLookupError:
        return True
    with os.fdopen(handle):
        return bool(select.select([handle], [], [], 20)[0])


@pytest.mark.slow
def test_an_fmu_that_ends_its_process_fails_a_run_and_the_next_one_goes_on(rods):
    fmu = fmu_of(rods, ABORTS)
    process = process_of(fmu)
    run = al.foreign.FmuSimulation(fmu, GRID, outputs=["angle"])
    message = "FMU 'rod3_mc' ended its process by the signal SIGABRT, with fail_at=0.6; it printed: assertion failed"
    with pytest.raises(al.SimulationError, match=f"^{message}"):
        run({"fail_at": 0.6})
    assert has_ended(process)
    values = run({"fail_at": 9.0})["angle"]
    assert np.array_equal(values, al.foreign.FmuSimulation(here(rods(3)), GRID, outputs=["angle"])({})["angle"])
    process = process_of(fmu)
    del run, fmu
    gc.collect()
    assert has_ended(process), "an FMU that nobody holds has no process"


@pytest.mark.slow
def test_an_fmu_that_loops_for_ever_is_ended_after_its_time_limit(rods):
    fmu = fmu_of(rods, LOOPS, time_limit=1.0, kind="co-simulation")
    process = process_of(fmu)
    run = al.foreign.FmuSimulation(fmu, GRID, outputs=["angle"])
    message = (
        r"^FMU 'rod3_mc' did not end a run within its time limit of 1 s, with fail_at=0.6: its process was ended\."
    )
    with pytest.raises(al.SimulationError, match=message):
        run({"fail_at": 0.6})
    assert has_ended(process)
    assert np.isfinite(run({"fail_at": 9.0})["angle"]).all()


@pytest.mark.slow
def test_a_run_is_sent_to_other_processes_as_its_file(rods, tmp_path):
    path = tmp_path / "sent.fmu"
    shutil.copy(rods(3), path)
    run = al.foreign.FmuSimulation(here(path), GRID, outputs=["angle"])
    system = al.foreign.FmuSystem(here(path), {"damping": 0.2})
    packed = pickle.dumps((run, system))
    again, system_again = pickle.loads(packed)
    assert np.array_equal(again({})["angle"], run({})["angle"])
    assert np.array_equal(system_again.initial()["angle"], system.initial()["angle"])
    assert pickle.loads(packed)[0]._fmu is again._fmu
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("note", "changed")
    _opened_again.cache_clear()
    with pytest.raises(al.ProblemError, match=r"FMU 'sent': '.*sent\.fmu' has changed since the model was made"):
        pickle.loads(packed)


def test_a_journal_tells_apart_fmus_of_one_name_and_their_inputs(rods, tmp_path):
    path, ramp = tmp_path / "same.fmu", al.Tabulated([0.0, 2.0], [0.0, 1.0])

    def kept(fmu, **given):
        run = al.foreign.FmuSimulation(fmu, GRID, outputs=["angle"], **given)
        box = al.foreign.BlackBox(run, journal=tmp_path / "runs.jsonl")
        al.references.monte_carlo(box, {"damping": al.Uniform(0.1, half_width=0.05)}, samples=4, seed=1)
        return len((tmp_path / "runs.jsonl").read_text().splitlines())

    shutil.copy(rods(3), path)
    assert [kept(here(path)), kept(here(path))] == [5, 5]
    assert kept(here(path), inputs={"torque": ramp}) == 9
    shutil.copy(rods(3, wall=True), path)
    assert kept(here(path)) == 13
