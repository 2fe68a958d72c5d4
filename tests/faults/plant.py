"""Plant faults one at a time and tell which tests catch them: a net under the suite, for whoever shortens it.

    python tests/faults/plant.py [NAME...] [--list] [--jobs N] [--tests FILE...] [--limit SECONDS]

Each `NAME.patch` beside this file is a fault that a refactoring could introduce: prose (what is wrong, and what a user
would suffer), a line `Tests:` with the files, folders or globs that should catch it, likely ones first, and the change.
For each, the patch is applied to a copy of the tree, and tests run until one fails, which must pass without the fault.
One line is printed for each: `caught  NAME  by TEST`, `MISSED  NAME`, or `BROKEN  NAME` where the patch does not apply,
the source cannot be imported, tests cannot be collected, or they fail without the fault. A run beyond the limit counts
as caught only where the prose has the line `Hangs.` The exit status is 1 if any fault is missed or broken.
"""

import argparse
import contextlib
import os
import queue
import re
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
# Tests in their own order, so that the one that fails is that which fails alone.
PYTEST = ("-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", "-p", "no:randomly", "--tb=short")


def copied(folder: Path) -> Path:
    """A copy of what is committed or could be, without the faults, in a new folder."""
    listed = subprocess.check_output(["git", "ls-files", "-z", "-co", "--exclude-standard"], cwd=ROOT, text=True)
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file() and HERE not in (ROOT / name).parents:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def python(tree: Path, limit: float, *arguments: str) -> tuple[int | None, str]:
    """The exit status of Python on the source of a copy, None beyond the limit, and what it printed."""
    # Compiled programs are shared by all runs: JAX finds them by their text, which a fault changes.
    own = {"PYTHONPATH": str(tree / "src"), "JAX_COMPILATION_CACHE_DIR": str(tree.parent / "programs")}
    rest = {name: value for name, value in os.environ.items() if name != "ALEATOR_CACHE"}
    how = {"cwd": tree, "env": {**rest, **own, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}, "timeout": limit}
    with tempfile.TemporaryFile("w+") as output:
        code = None
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = subprocess.run([sys.executable, *arguments], stdout=output, stderr=output, **how).returncode
        output.seek(0)
        return code, output.read()


def written(file: Path, content: bytes) -> None:
    """Write a source, and forget what was compiled from another version within the same second."""
    file.write_bytes(content)
    for compiled in file.parent.glob(f"__pycache__/{file.stem}.*"):
        compiled.unlink()


def judged(patch: Path, tree: Path, patterns: list[str], limit: float) -> tuple[str, str]:
    """`caught`, `MISSED` or `BROKEN`, and why."""
    text = patch.read_text(encoding="utf-8")
    (source,), (told,) = (re.findall(form, text, re.MULTILINE) for form in (r"^\+\+\+ b/(\S+)$", r"^Tests: (.+)$"))
    places = [place for pattern in patterns or told.split() for place in sorted(tree.glob(pattern))]
    tests = [test for one in places for test in (sorted(one.rglob("test_*.py")) if one.is_dir() else [one])]
    if not tests:
        return "BROKEN", f"there are no tests {told}"
    file = tree / source
    before = file.read_bytes()
    try:
        applied = subprocess.run(["git", "apply", str(patch)], cwd=tree, capture_output=True, text=True, check=False)
        written(file, file.read_bytes())
        if file.read_bytes() == before:
            return "BROKEN", f"the patch does not apply: {applied.stderr.strip()}"
        module = source.removeprefix("src/").removesuffix(".py").replace("/", ".")
        code, said = python(tree, limit, "-c", f"import aleator, {module}; print(aleator.__file__)")
        if code or not said.strip().endswith(str(tree / "src/aleator/__init__.py")):
            return "BROKEN", f"the source of the copy is not imported: {said.strip()[-500:]}"
        code, said = python(tree, limit, *PYTEST, *dict.fromkeys(map(str, tests)))
    finally:
        written(file, before)
    failed = re.search(r"^(?:FAILED|ERROR) (\S+::.*?)(?: - .*)?$", said, re.MULTILINE)
    if code is None:
        return "caught" if "\nHangs.\n" in text else "MISSED", f"after {limit:g} s"
    if code == 0:
        return "MISSED", ""
    if code != 1 or failed is None:
        return "BROKEN", said.strip()[-500:]
    sound, said = python(tree, limit, *PYTEST, failed[1])
    return ("caught", f"by {failed[1]}") if sound == 0 else ("BROKEN", f"{failed[1]} fails without it: {said[-500:]}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Plant faults and tell which tests catch them.")
    parser.add_argument("names", nargs="*", help="faults, all by default")
    parser.add_argument("--list", action="store_true", help="print faults and what is wrong with each")
    parser.add_argument("--jobs", type=int, default=1, help="how many at a time")
    parser.add_argument(
        "--tests", nargs="+", default=[], help="files, folders or globs in the place of the faults' own"
    )
    parser.add_argument("--limit", type=float, default=900.0, help="seconds for each run")
    given = parser.parse_args()
    patches = [HERE / f"{name}.patch" for name in given.names] or sorted(HERE.glob("*.patch"))
    if given.list:
        print(*(f"{one.stem}\n{one.read_text(encoding='utf-8').split('--- a/')[0]}" for one in patches), sep="\n")
        sys.exit()
    with tempfile.TemporaryDirectory(prefix="aleator-faults-") as folder, ThreadPoolExecutor(given.jobs) as pool:
        trees: queue.Queue[Path] = queue.Queue()
        for job in range(given.jobs):
            trees.put(copied(Path(folder).resolve() / str(job)))

        def verdict_on(patch: Path) -> str:
            tree = trees.get()
            verdict, why = judged(patch, tree, given.tests, given.limit)
            trees.put(tree)
            print(f"{verdict:<7} {patch.stem}  {why}".rstrip(), flush=True)
            return verdict

        sys.exit(0 if set(pool.map(verdict_on, patches)) == {"caught"} else 1)
