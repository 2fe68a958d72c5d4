"""Processes do what threads do, to the last bit, although one of them dies: al.workers, loky's and a Dask cluster's."""

import os
import signal
import subprocess
import sys
import textwrap
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np
import pytest

import aleator as al
from executors import dies, dies_once
from zoo import bar_problem, valleys_problem

VALUES = [0.5, 0.4, 0.6, 0.7]
SEARCH = al.solvers.DifferentialEvolution(evaluations=80, population=40)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="processes are killed by a signal"),
]


def ran(script: str, folder: Path, *arguments: str) -> subprocess.CompletedProcess:
    """A script that has ended, in a folder, with the modules of these tests."""
    (folder / "script.py").write_text(textwrap.dedent(script))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])}
    command = [sys.executable, "script.py", *arguments]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300, start_new_session=True
    )


class Mortal(al.AlgebraicSystem):
    """Kills the first process besides the one that declared it in which it is traced."""

    place: al.Number
    off: al.Number
    mark: str
    home: int

    def outputs(self):
        if os.getpid() != self.home and not Path(self.mark).exists():
            Path(self.mark).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return {"depth": (self.place**2 - 1.0) ** 2 + 0.2 * self.place + self.off}


def searched(*given, **options) -> np.ndarray:
    return al.solve(*given, **options).effort.searched.objectives


def test_the_death_of_a_worker_is_survived_with_the_results_of_here_and_work_that_always_kills_its_worker_ends(
    tmp_path: Path,
):
    front = al.pareto(bar_problem(), "stress", VALUES)
    mortal = Mortal(al.Decision(0.5, -2.0, 2.0), al.Normal(0.0, 0.1), str(tmp_path / "mark"), os.getpid())
    with al.workers(2) as executor:
        there = al.pareto(bar_problem(), "stress", VALUES, executor=executor)
        counted = [al.validate(front.solutions[0], 5000, executor=one) for one in (None, executor)]
        found = searched(al.Problem(mortal, minimize=al.output("depth").mean), SEARCH, executor=executor)
        assert (tmp_path / "mark").exists()
        futures = [executor.submit(dies_once, str(tmp_path / "once"), number) for number in range(8)]
        assert [one.result() for one in futures] == [2 * number for number in range(8)]
        assert (tmp_path / "once").exists()
        with pytest.raises(BrokenProcessPool):
            executor.submit(dies, 1).result()
    assert there.objectives.tobytes() == front.objectives.tobytes()
    assert there.shadow_prices.tobytes() == front.shadow_prices.tobytes()
    here, elsewhere = (np.ascontiguousarray(one.functionals["stress"].values).tobytes() for one in counted)
    assert here == elsewhere
    assert found.tobytes() == searched(valleys_problem(), SEARCH).tobytes()


ON_A_CLUSTER = """
    import os
    import signal
    import sys

    import numpy as np
    from dask.distributed import Client, LocalCluster
    from loky import get_reusable_executor

    import aleator as al
    from zoo import bar_problem, valleys_problem

    VALUES = [0.5, 0.4, 0.6, 0.7]


    def main():
        search = al.solvers.DifferentialEvolution(evaluations=80, population=40)
        loky = al.solve(valleys_problem(), search, executor=get_reusable_executor(2)).effort.searched.objectives
        cluster = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
        with cluster, Client(cluster) as client:
            workers = list(client.run(os.getpid).values())

            def kill(task, done, total):
                if done == 2 and len(workers) == 2:
                    os.kill(workers.pop(), signal.SIGKILL)

            executor = client.get_executor()
            dask = al.pareto(bar_problem(), "stress", VALUES, executor=executor, progress=kill).objectives
        np.savez(sys.argv[1], loky=loky, dask=dask)
        assert len(workers) == 1, "no worker was killed"


    if __name__ == "__main__":
        main()
"""


def test_searches_of_loky_and_fronts_of_a_cluster_whose_worker_is_killed_are_the_same(tmp_path: Path):
    done = ran(ON_A_CLUSTER, tmp_path, "found.npz")
    assert done.returncode == 0, done.stderr
    with np.load(tmp_path / "found.npz") as found:
        assert found["dask"].tobytes() == al.pareto(bar_problem(), "stress", VALUES).objectives.tobytes()
        assert found["loky"].tobytes() == searched(valleys_problem(), SEARCH).tobytes()
