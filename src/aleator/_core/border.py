"""Checks of a user's inputs: numbers, whole numbers, names, objects of a type, reports of progress, files.

Each check returns its value in the form in which it is stored, or raises `ProblemError`: one sentence with what was
expected and what was received. `what` begins the sentence: "Grid: steps", "validate: the seed".
"""

import contextlib
import difflib
import errno
import inspect
import json
import reprlib
import stat
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from aleator._core.arrays import may_hold
from aleator._core.errors import ProblemError

Kind = TypeVar("Kind")

# Most characters of a value in a message.
_SHOWN = 80
# A name as close to a known one is a slip.
_SLIP = 0.85

_reprs = reprlib.Repr()
_reprs.maxstring = _reprs.maxother = _SHOWN


def shown(value: Any) -> str:
    """A value for messages: shortened, and with its type if that is not obvious."""
    text = " ".join(_reprs.repr(value).split())
    is_plain = value is None or isinstance(value, bool | int | float | complex | str | bytes | list | tuple | dict)
    kind = type(value).__name__
    return text if is_plain or kind in text else f"{kind} {text}"


def refusal(what: str, expected: str, value: Any) -> ProblemError:
    """The error that says what was expected instead of `value`."""
    return ProblemError(f"{what}: expected {expected}; received {shown(value)}.")


@contextlib.contextmanager
def writing(who: str, path: Any) -> Iterator[Path]:
    """The path of a file that is written meanwhile. Raises `ProblemError`, with the reason, if it cannot be."""
    try:
        file = Path(path)
    except TypeError as error:
        raise refusal(who, "the path of a file", path) from error
    try:
        yield file
    except OSError as error:
        what = f"the folder {file.parent} does not exist" if not file.parent.is_dir() else error.strerror or error
        raise ProblemError(f"{who}: {file} cannot be written ({what}).") from error


def meant(name: str, known: Collection[str]) -> str:
    """A question that names the known name nearest to an unknown one; empty if none is near."""
    alike = [one for one in known if one.lower() == name.lower()]
    alike = alike or [one for one in known if one.startswith(f"{name}.")]
    close = alike or difflib.get_close_matches(name, known, n=1)
    return f" Did you mean '{close[0]}'?" if close else ""


def is_masked(value: Any) -> bool:
    """Whether numbers of a masked array are missing, which NumPy would replace by the data behind the mask."""
    parts = value if isinstance(value, list | tuple) else (value,)
    return any(isinstance(part, np.ma.MaskedArray) and bool(np.ma.is_masked(part)) for part in parts)


def real_array(what: str, value: Any, expected: str = "real numbers") -> Float[np.ndarray, "..."]:
    """Known numbers as a new array. Text, truth values and missing values are no numbers."""
    try:
        array = None if is_masked(value) else np.asarray(value)
    except (TypeError, ValueError):
        array = None
    if array is None or not (array.dtype.kind in "iuf" or (array.size == 0 and array.ndim)):
        raise refusal(what, expected, value)
    return np.array(array, dtype=float)


def _entry(place: tuple[int, ...]) -> str:
    return f"entry {', '.join(map(str, place))}"


def refuse_not_finite(
    what: str, numbers: Float[np.ndarray, "..."], at: Callable[[tuple[int, ...]], str] = _entry
) -> None:
    """Raise `ProblemError` for the first number that is not finite; `at`: a place in the array in words."""
    if not np.isfinite(numbers).all():
        place = tuple(int(one) for one in np.argwhere(~np.isfinite(numbers))[0])
        where = f" at {at(place)}" if place else ""
        raise ProblemError(f"{what}: expected finite numbers; received {numbers[place]:g}{where}.")


def real(what: str, value: Any, expected: str = "a finite number", *, least: float = -np.inf) -> float:
    """One finite number, at `least` a limit if one is given."""
    expected += f" of at least {least:g}" if least > -np.inf else ""
    array = real_array(what, value, expected)
    if array.ndim or not np.isfinite(array) or array < least:
        raise refusal(what, expected, value)
    return float(array)


def positive(what: str, value: Any, *, below: float = np.inf, most: float = np.inf) -> float:
    """A positive finite number, `below` a limit or at `most` a limit if one is given."""
    limit = f" below {below:g}" if below < np.inf else f" of at most {most:g}" if most < np.inf else ""
    expected = f"a positive number{limit}"
    number = real(what, value, expected)
    if not (0 < number < below and number <= most):
        raise refusal(what, expected, value)
    return number


def whole(what: str, value: Any, *, least: int = 1) -> int:
    """A whole number, of Python or NumPy."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ProblemError(f"{what} is a whole number of at least {least}; received {shown(value)}.")
    return int(value)


def a_name(what: str, value: Any) -> str:
    """A name: a non-empty text."""
    if not isinstance(value, str) or not value:
        raise refusal(what, "a name", value)
    return value


def one_of(what: str, value: Any, kinds: type[Kind] | tuple[type[Kind], ...], example: str = "") -> Kind:
    """An object of one of some types."""
    if isinstance(value, kinds):
        return value
    names = " or ".join(kind.__name__ for kind in (kinds if isinstance(kinds, tuple) else (kinds,)))
    raise refusal(what, f"{names}{example and f', such as {example}'}", value)


def members(what: str, value: Any, kinds: type[Kind] | tuple[type[Kind], ...]) -> Sequence[Kind]:
    """A sequence of objects of some types. A text is refused, although its letters are texts."""
    names = " or ".join(kind.__name__ for kind in (kinds if isinstance(kinds, tuple) else (kinds,)))
    expected = f"a list of {'texts' if kinds is str else names}"
    if isinstance(value, str | bytes) or not isinstance(value, Sequence):
        raise refusal(what, expected, value)
    for i, one in enumerate(value):
        if not isinstance(one, kinds):
            raise refusal(f"{what}, entry {i}", "a text" if kinds is str else names, one)
    return value


def traceable(what: str, value: Any) -> Float[Array, "..."]:
    """Real numbers, known or traced, as an array, for values that a model's own code returns."""
    expected = "real numbers"
    if is_masked(value) or (isinstance(value, eqx.Module) and not hasattr(value, "__jax_array__")):
        raise refusal(what, expected, value)
    if isinstance(value, int | float | np.generic | np.ndarray) and np.asarray(value).dtype.kind in "biuf":
        value = np.asarray(value, dtype=float)  # of a number as it stands JAX would compile a program
    try:
        array = jnp.asarray(value)
    except jax.errors.JAXTypeError:
        raise
    except (TypeError, ValueError) as error:
        raise refusal(what, expected, value) from error
    if jnp.issubdtype(array.dtype, jnp.complexfloating):
        raise ProblemError(f"{what}: expected {expected}; received complex ones, of shape {array.shape}.")
    return jnp.asarray(array, dtype=float)


def refuse_slip(who: str, name: str, optional: Sequence[str]) -> None:
    """Raise `ProblemError` for the name of something in a class that is a slip away from one that would be read."""
    if close := difflib.get_close_matches(name, optional, n=1, cutoff=_SLIP):
        raise ProblemError(f"{who}.{name} has no effect: did you mean {close[0]}? Rename it, even if it is your own.")


def refuse_missing(name: str, value: Any) -> None:
    """Raise `ProblemError` for a missing number of a model: masked, or NaN."""
    is_nan = isinstance(value, float | np.floating | np.ndarray | jax.Array) and not isinstance(value, Tracer)
    if is_masked(value) or (is_nan and bool(np.any(np.isnan(value)))):
        raise refusal(f"'{name}'", "numbers", value)


def refuse_leaf(name: str, leaf: Any) -> None:
    """Raise `ProblemError` for what no model can hold: missing numbers, and what is neither numbers nor fixed."""
    if isinstance(leaf, np.ndarray) and leaf.dtype.kind not in "biufc":
        raise refusal(f"'{name}'", "numbers in an array, and distributions or texts in a tuple", leaf)
    if type(leaf).__hash__ is None and not isinstance(leaf, np.ndarray | jax.Array):
        expected = "numbers, or what can be hashed; numbers in parts of your own in an equinox.Module or a NamedTuple"
        raise refusal(f"'{name}'", expected, leaf)
    refuse_missing(name, leaf)


Progress: TypeAlias = Callable[[str, int, int], None]


def silent(task: str, done: int, total: int) -> None:
    """Report nothing."""
    del task, done, total


def takes(function: Any, *arguments: Any) -> bool:
    """Whether something can be called with such arguments, as far as it tells: what is not written in Python need not
    have a signature.
    """
    if not callable(function):
        return False
    try:
        inspect.signature(function).bind(*arguments)
    except TypeError:
        return False
    except ValueError:
        pass
    return True


def check_progress(who: str, progress: Any) -> None:
    """Refuse what cannot be called with the task, the steps done and their total."""
    if not takes(progress, "", 0, 1):
        expected = "a function of three arguments, the task, the steps done and their total"
        raise refusal(f"{who}: progress", expected, progress)


def content_of(path: str | Path) -> bytes:
    """The content of a regular file that fits into memory; a pipe or a device may never end.

    Raises `OSError`.
    """
    path = Path(path)
    found = path.stat()
    if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
        raise OSError(errno.EINVAL, "it is a pipe or a device, not a file", str(path))
    if not may_hold(found.st_size):
        raise OSError(errno.EFBIG, "it is larger than half of this machine's memory", str(path))
    return path.read_bytes()


def json_of(content: str | bytes, **options: Any) -> Any:
    """What JSON says. Raises `ValueError` for anything else, and for what is nested too deeply."""
    try:
        return json.loads(content, **options)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
