"""Parts of a computation on several devices give what one device gives; where JAX sees a GPU, so does that."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from aleator._core.compilation import Use, compiled_for

SCRIPT = Path(__file__).with_name("answers_on_devices.py")
SEVERAL = 4


def ran(*arguments, **environment):
    """What the script tells in a process of its own."""
    flags = re.sub(r"--xla_force_host_platform_device_count=\d+", "", os.environ.get("XLA_FLAGS", ""))
    environment = {**os.environ, "XLA_FLAGS": f"{flags} {environment.pop('flags', '')}".strip(), **environment}
    finished = subprocess.run(
        [sys.executable, str(SCRIPT), *arguments], env=environment, capture_output=True, text=True, check=False
    )
    assert finished.returncode == 0, finished.stderr
    return json.loads(finished.stdout)


@pytest.fixture(scope="module")
def on_one():
    return ran(JAX_PLATFORMS="cpu")


@pytest.fixture(scope="module")
def on_several():
    flags = f"--xla_force_host_platform_device_count={SEVERAL}"
    return ran("placed", JAX_PLATFORMS="cpu", flags=flags)


def test_several_devices_give_the_digits_of_one(on_one, on_several):
    assert [on_one["devices"], on_several["devices"]] == [1, SEVERAL]
    assert on_one["answers"]["ok"]
    assert on_several["answers"] == on_one["answers"]


def test_parts_are_computed_on_the_devices_in_turn(on_one, on_several):
    assert on_one["turns"] == [[0, 0]] * 6
    assert on_several["turns"] == [[item % SEVERAL, item % SEVERAL] for item in range(6)]


def test_each_device_compiles_what_it_runs_and_no_more(on_one, on_several):
    assert [on_one["parts"], on_one["batches"]] == [1, 1]
    # Two parts of the collocation points, on two of the devices; eleven batches of systems, on all.
    assert [on_several["parts"], on_several["batches"]] == [2, SEVERAL]


def test_a_model_is_traced_once_for_all_devices_and_by_the_calling_thread_alone(on_one, on_several):
    assert len(on_several["traced"]) == len(on_one["traced"])
    for told in (on_one, on_several):
        assert set(told["traced"]) == {told["here"]} == set(told["run_by"])


def test_what_fails_on_a_device_does_so_in_its_turn(on_several):
    assert on_several["failed"] == [0, 0, 1, "failed"]


def test_the_device_that_jax_is_told_to_use_computes_everything(on_several):
    last = SEVERAL - 1
    assert on_several["told"] == [last, [[last, last]] * 6]


def test_what_follows_from_an_array_on_a_device_stays_there(on_several):
    assert on_several["placed"] == on_several["answers"]["decisions"]


class Recorded:
    """A traced program that notes the options with which it is compiled."""

    options: Any = None

    def compile(self, compiler_options=None):
        self.options = compiler_options


@pytest.mark.parametrize("use", list(Use))
def test_options_of_the_compiler_for_cpus_are_given_to_no_other(use):
    given = {}
    for platform in ("cpu", "gpu", "tpu"):
        recorded: Any = Recorded()
        compiled_for(use, recorded, platform)
        given[platform] = recorded.options
    assert given == {"cpu": use.value, "gpu": {}, "tpu": {}}
    assert use.value


def gpus():
    """How many GPUs JAX sees; none where it has been told of CPUs alone."""
    try:
        return len(jax.local_devices(backend="gpu"))
    except RuntimeError:
        return 0


@pytest.mark.skipif(not gpus(), reason="JAX sees no GPU on this machine")
def test_a_gpu_gives_the_answers_of_the_processor(on_one):
    found = ran(JAX_PLATFORMS="")
    assert found["answers"]["ok"]
    # Sums in another order and other elementary functions: the last digits differ, and with them, at an optimum, the
    # decisions by the square root of what the solver's tolerance leaves open.
    for name, tolerance in (("decisions", 1e-5), ("objective", 1e-9), ("sampled", 1e-5), ("expanded", 1e-12)):
        one, other = (np.array([float.fromhex(bit) for bit in told["answers"][name]]) for told in (found, on_one))
        np.testing.assert_allclose(one, other, rtol=tolerance, atol=tolerance)
