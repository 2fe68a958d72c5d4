"""Whatever happens to the file of a kept executable, the answer is right, and a good file follows without a word."""

import os
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache as persistent

import aleator as al
from aleator._core import kept_programs, lasting, stored
from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled
from aleator._core.lasting import lasting_name

GIVEN = (np.linspace(0.0, 1.0, 3), 2.0)
OTHER = (2.0, np.linspace(1.0, 0.0, 5))


@pytest.fixture
def folder(tmp_path):
    """The folder in which programs are kept, for one test."""
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: getattr(jax.config, name) for name in names}
    al.compilation_cache(tmp_path)
    yield kept_programs.own_folder()
    al.compilation_cache(None)
    for name, value in before.items():
        jax.config.update(name, value)
    persistent.reset_cache()


def called(given=GIVEN):
    """Whether a program was traced in a call as the first one of a run; its results are checked."""
    traced: list[str] = []

    def hear(event: str, duration_secs: float, **about: str | int) -> None:
        if event.endswith("jaxpr_trace_duration") and str(about.get("fun_name")).startswith("flat"):
            traced.append(event)

    jax.monitoring.register_event_duration_secs_listener(hear)
    try:
        results = Compiled(numbers_to_arrays)(jax.tree.map(jnp.asarray, given))
    finally:
        jax.monitoring.unregister_event_duration_listener(hear)
    for result, number in zip(results, given, strict=True):
        np.testing.assert_array_equal(result, number)
    return len(traced) == 1


def files(folder):
    return sorted(folder.glob("aleator_*"))


def the_file(folder):
    """The only file of a program that has been called."""
    assert called()
    (path,) = files(folder)
    return path


def test_it_is_kept_once_and_found_again(folder):
    the_file(folder)
    assert not called()
    assert not list(folder.glob("jit_flat*")), "JAX keeps a second copy"


def lost(path):
    path.unlink()


def cut(path):
    path.write_bytes(path.read_bytes()[:1000])


def emptied(path):
    path.write_bytes(b"")


def altered(path):
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 1
    path.write_bytes(whole)


def of_another_version(path):
    """Whole, but with a content that cannot be unpickled."""
    name = path.name.removeprefix("aleator_").removesuffix("-cache")
    path.write_bytes(stored._digest(name, b"other") + b"other")


def of_another_program(path):
    assert called(OTHER)
    (other,) = (one for one in files(path.parent) if one != path)
    other.replace(path)


def open_to_others(path):
    path.chmod(0o666)


def a_folder(path):
    path.unlink()
    path.mkdir()


on_posix = pytest.mark.skipif(sys.platform == "win32", reason="rights of POSIX systems")
CHANGES = [lost, cut, emptied, altered, of_another_version, of_another_program]


@pytest.mark.parametrize("change", [*CHANGES, pytest.param(open_to_others, marks=on_posix)])
def test_a_file_that_is_not_as_it_was_kept_is_replaced(folder, change, capfd):
    path = the_file(folder)
    change(path)
    assert called()
    assert not called(), "nothing good was kept"
    assert capfd.readouterr().err == ""


def test_what_cannot_even_be_deleted_is_compiled_each_time(folder):
    a_folder(the_file(folder))
    assert called()
    assert called()


@on_posix
def test_a_file_of_another_user_is_not_read(folder, monkeypatch):
    path = the_file(folder)
    monkeypatch.setattr(os, "getuid", lambda: path.stat().st_uid + 1)
    monkeypatch.setattr(stored.pickle, "loads", lambda _: pytest.fail("read"))
    assert called()


@on_posix
def test_a_file_is_closed_to_others_whatever_the_mask(folder):
    before = os.umask(0)
    try:
        path = the_file(folder)
    finally:
        os.umask(before)
    assert path.stat().st_mode & 0o777 == 0o600


def test_one_that_loads_but_cannot_run_is_replaced(folder, monkeypatch):
    the_file(folder)

    def fail(*_):
        raise jax.errors.JaxRuntimeError("INVALID_ARGUMENT: Expected 2 shards, got 1")

    with monkeypatch.context() as patched:
        patched.setattr(stored.serialize_executable, "deserialize_and_load", lambda *_: fail)
        assert called()
    assert not called()


def test_a_write_that_fails_or_is_interrupted_leaves_no_half_of_a_file(folder, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", full)
        assert called()
    assert files(folder) == []
    assert not list(folder.glob(".*"))


def test_what_a_killed_run_was_writing_is_counted_and_deleted(folder, monkeypatch):
    def killed(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", killed)
        patched.setattr(Path, "unlink", lambda *_, **__: None)
        with pytest.raises(KeyboardInterrupt):
            called()
    assert len(list(folder.glob(".*"))) == 1
    monkeypatch.setattr(kept_programs, "_MOST_BYTES", 0)
    kept_programs._forget_oldest(folder)
    assert list(folder.iterdir()) == []


def test_nothing_is_kept_or_read_once_it_is_turned_off(folder):
    path = the_file(folder)
    al.compilation_cache(None)
    path.write_bytes(b"rubbish")
    assert called()
    assert path.read_bytes() == b"rubbish"


def test_the_bound_holds_for_all_versions_and_machines_and_spares_other_files(tmp_path, monkeypatch):
    monkeypatch.setattr(kept_programs, "_MOST_BYTES", 100)
    paths = [tmp_path / part / "aleator_a-cache" for part in ("0" * 16, "1" * 16, "of a user")]
    for path in paths:
        path.parent.mkdir()
        path.write_bytes(bytes(100))
    os.utime(paths[1], (1e9, 1e9))
    kept_programs._forget_oldest(paths[1].parent)
    assert [path.exists() for path in paths] == [True, False, True]


@on_posix
@pytest.mark.parametrize("others", ["write", "own"])
def test_a_folder_that_others_can_write_to_is_refused(folder, monkeypatch, others):
    if others == "write":
        folder.chmod(0o777)
    else:
        monkeypatch.setattr(os, "getuid", lambda: folder.stat().st_uid + 1)
    with pytest.raises(al.ProblemError, match="belongs to another user, or others can write to it"):
        al.compilation_cache(folder.parent)


def named():
    return lasting_name(numbers_to_arrays, (1,))


@pytest.mark.parametrize(
    "change",
    [
        lambda patched: patched.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=true"),
        lambda patched: patched.setenv("TF_XLA_FLAGS", "--tf_xla_auto_jit=2"),
        lambda patched: patched.setattr(lasting, "CORES", lasting.CORES + 1),
        lambda patched: patched.setattr(lasting, "_libraries", lambda: "other sources"),
    ],
    ids=["flags", "flags of other libraries", "cores", "sources"],
)
def test_what_surrounds_a_program_is_part_of_its_name(monkeypatch, change):
    before = named()
    assert before is not None
    with monkeypatch.context() as patched:
        change(patched)
        assert named() != before
    assert named() == before


def test_the_length_of_numbers_is_part_of_a_name():
    with jax.enable_x64(True):
        long = named()
    with jax.enable_x64(False):
        short = named()
    assert None not in (long, short)
    assert long != short


def test_with_several_devices_programs_have_no_names(monkeypatch):
    monkeypatch.setattr(jax, "device_count", lambda: 2)
    assert named() is None


def test_with_sources_newer_than_this_run_programs_have_no_names(monkeypatch):
    # What has been imported may be older than they are.
    monkeypatch.setattr(lasting, "_libraries", lasting._libraries.__wrapped__)
    assert named() is not None
    monkeypatch.setattr(lasting, "_BEGAN", 0.0)
    assert named() is None


def test_what_holds_itself_has_no_name():
    loop: list[object] = []
    loop.append(loop)
    assert lasting_name(numbers_to_arrays, (loop,)) is None


def test_the_features_of_the_processor_choose_the_folder(monkeypatch, tmp_path):
    monkeypatch.setattr(kept_programs, "_PROCESSOR", tmp_path / "cpuinfo")
    kinds = []
    for features in ("sse avx", "sse"):
        (tmp_path / "cpuinfo").write_text(f"processor\t: 0\nflags\t: {features}\n\nprocessor\t: 1")
        kinds.append(kept_programs._kind())
    assert kinds[0] != kinds[1]


def test_machines_of_unknown_features_have_folders_of_their_own(monkeypatch, tmp_path):
    monkeypatch.setattr(kept_programs, "_PROCESSOR", tmp_path / "missing")
    kinds = []
    for machine in ("one", "other"):
        monkeypatch.setattr(kept_programs.platform, "node", lambda machine=machine: machine)
        kinds.append(kept_programs._kind())
    assert kinds[0] != kinds[1]
