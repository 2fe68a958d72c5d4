"""Parts of a computation on several devices give what one device gives; where JAX sees a GPU, so does that."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from aleator._core.parallel import here, over_devices

SCRIPT = Path(__file__).with_name("answers_on_devices.py")
SEVERAL = 4


def ran(*arguments, flags="", platforms="cpu"):
    """What the script tells in a process of its own."""
    others = re.sub(r"--xla_force_host_platform_device_count=\d+", "", os.environ.get("XLA_FLAGS", ""))
    environment = os.environ | {"XLA_FLAGS": f"{others} {flags}".strip(), "JAX_PLATFORMS": platforms}
    finished = subprocess.run(
        [sys.executable, str(SCRIPT), *arguments], env=environment, capture_output=True, text=True, check=False
    )
    assert finished.returncode == 0, finished.stderr
    return json.loads(finished.stdout)


@pytest.fixture(scope="module")
def on_one():
    return ran()


@pytest.mark.slow
def test_several_devices_give_the_digits_of_one_and_compute_parts_in_turn(on_one):
    on_several, last = ran("placed", flags=f"--xla_force_host_platform_device_count={SEVERAL}"), SEVERAL - 1
    assert [on_one["devices"], on_several["devices"]] == [1, SEVERAL]
    assert on_one["answers"]["ok"]
    assert on_several["answers"] == on_one["answers"]
    assert on_one["turns"] == [[0, 0]] * 6
    assert on_several["turns"] == [[item % SEVERAL, item % SEVERAL] for item in range(6)]
    # What JAX or a user has placed stays there.
    assert on_several["told"] == [last, [[last, last]] * 6]
    assert on_several["placed"] == on_several["answers"]["decisions"]
    # Each device compiles what it runs: two parts of the collocation points, on two of the devices; eleven batches of
    # systems, on all.
    assert [on_one["parts"], on_one["batches"]] == [1, 1]
    assert [on_several["parts"], on_several["batches"]] == [2, SEVERAL]


def test_parts_come_in_their_order_and_a_failure_in_its_turn():
    assert list(over_devices(lambda item: item * item, range(20))) == [item * item for item in range(20)]
    results = over_devices(lambda item: 1 // (3 - item), range(6))
    assert [next(results) for _ in range(3)] == [0, 0, 1]
    with pytest.raises(ZeroDivisionError):
        next(results)
    first, told = jax.local_devices()[0], []
    with jax.default_device(first):
        assert list(over_devices(lambda item: told.append((item, here().id)) or item, range(3))) == [0, 1, 2]
    assert {place for _, place in told} == {first.id}


def gpus():
    """How many GPUs JAX sees; none where it has been told of CPUs alone."""
    try:
        return len(jax.local_devices(backend="gpu"))
    except RuntimeError:
        return 0


@pytest.mark.slow
@pytest.mark.skipif(not gpus(), reason="JAX sees no GPU on this machine")
def test_a_gpu_gives_the_answers_of_the_processor(on_one):
    found = ran(platforms="")
    assert found["answers"]["ok"]
    # Sums in another order and other elementary functions: the last digits differ, and with them, at an optimum, the
    # decisions by the square root of what the solver's tolerance leaves open.
    for name, tolerance in (("decisions", 1e-5), ("objective", 1e-9), ("sampled", 1e-5), ("expanded", 1e-12)):
        one, other = (np.array([float.fromhex(bit) for bit in told["answers"][name]]) for told in (found, on_one))
        np.testing.assert_allclose(one, other, rtol=tolerance, atol=tolerance)
