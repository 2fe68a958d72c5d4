"""Names of programs that are valid in other processes too, from code, structure and the versions of libraries.

Within one process a program is identified by its objects (classes, functions, equations). Another process has other
objects, so that their contents are written out here. Anything that cannot be written out, or might differ although its
text does not, is a doubt; then the program is traced.
"""

import dataclasses
import enum
import functools
import hashlib
import logging
import os
import platform
import sys
import time
import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from decimal import Decimal
from fractions import Fraction
from importlib import metadata
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from aleator._core.beside import CORES
from aleator._core.code import WRAPPERS, read_code
from aleator._core.equations import array_digest
from aleator._core.libraries import is_library
from aleator._core.readings import Again, Place, Plain, Reading, Same

# Libraries that trace and compile. The folder of programs is separate for each version of JAX; a journal's is not.
_TRACING = ("jax", "jaxlib", "equinox", "numpy", "scipy", "diffrax", "lineax", "optimistix")
_PLAIN = (str, bytes, int, bool, float, complex, type(None), type(Ellipsis), range, Decimal, Fraction, np.dtype)
_OF_NAMED_TUPLE = type(Place.who)  # a field of a named tuple, in its class
# Settings of JAX that do not affect a program.
_ASIDE = ("jax_compilation_cache_dir", "jax_persistent_cache", "jax_raise_persistent", "jax_log", "jax_explain")

# Environment variables that affect compilation begin with these.
_VARIABLES = ("XLA_", "TF_XLA_", "LIBTPU_", "EQX_")
_BEGAN = time.time()


class DoubtError(Exception):
    """Something has no text that identifies it in other processes."""


def lasting_name(function: Callable[..., Any], arguments: tuple[Any, ...], *how: Any) -> str | None:
    """A name for one of our functions, traced for arguments of one structure and compiled in some way.

    Programs of the same name compute the same, in any process; None if that is uncertain. The numbers of arrays are not
    part of it.
    """
    try:
        # Code comes first: a program without a user's code has none that could change.
        parts = [_surroundings(), *_named(function), *_texts(how), *_texts(arguments), *_read(read_code(arguments))]
    except Exception:  # besides doubts: a user's object may raise any if it is looked at, and may hold itself
        return None
    return joined(parts)


def lasting_parts(given: Mapping[str, Any]) -> dict[str, str]:
    """Digests of all that a result follows from, each by its name, besides `code` and `versions`; numbers included.

    Results with the same digests are equal, in any process. Raises `DoubtError` if that is uncertain.
    """
    known = {name: jax.tree.map(_in_numpy, one) for name, one in given.items()}
    try:
        parts = {name: joined(_texts(one)) for name, one in known.items()}
        return {**parts, "code": joined(_read(read_code(tuple(given.values())))), "versions": _libraries()}
    except DoubtError:
        raise
    except Exception as error:  # a user's object may raise any if it is looked at, and may hold itself
        raise DoubtError(f"looking at it raises {type(error).__name__}: {error}") from error


def _in_numpy(leaf: Any) -> Any:
    return np.asarray(leaf) if isinstance(leaf, jax.Array) else leaf


def joined(texts: Iterable[str]) -> str:
    """A digest of texts."""
    return hashlib.sha256("\0".join(texts).encode(errors="surrogatepass")).hexdigest()


def code_digest(function: Callable[..., Any]) -> str:
    """A digest of a user's function, equal in other processes: its name, its code and all that this reads.

    What cannot be written out is left out, and nothing else.
    """
    name = f"{getattr(function, '__module__', '')}.{getattr(function, '__qualname__', type(function).__qualname__)}"
    try:
        parts = [text for place, token in read_code(function).reads for text in _written(place, token)]
    except Exception:  # a user's object may raise any if it is looked at
        parts = _own_code(function)
    return hashlib.sha256("\0".join([name, *parts]).encode(errors="surrogatepass")).hexdigest()


def _own_code(function: Callable[..., Any]) -> list[str]:
    """The code of a function without what it reads; nothing if it has none that can be written out."""
    try:
        return list(_code(function.__code__))  # type: ignore[attr-defined]
    except Exception:
        return []


def _surroundings() -> str:
    """All else that a program depends on: settings of JAX, Equinox and XLA, devices, and libraries that trace it."""
    if jax.device_count() > 1 or jax.config.jax_default_device is not None:  # type: ignore[attr-defined]
        # On which device a program runs is no part of its name.
        raise DoubtError("there is more than one device, or a default one was chosen")
    # Attributes give the present values, even within a `with` statement; not every setting has one.
    known = {name: getattr(jax.config, name, value) for name, value in jax.config.values.items()}
    settings = [f"{name}={value}" for name, value in sorted(known.items()) if not name.startswith(_ASIDE)]
    settings += [f"{name}={value}" for name, value in sorted(os.environ.items()) if name.startswith(_VARIABLES)]
    device = jax.devices()[0]
    # When XLA compiles, it divides loops among the cores that the process may use.
    machine = [device.client.platform_version, device.device_kind, f"cores={CORES}"]
    return "\n".join([_libraries(), jax.default_backend(), *machine, *settings])


@functools.cache
def _libraries() -> str:
    """A digest of this package's sources and of the versions of libraries that trace.

    A doubt if a source has changed since this process began: others may be loaded than those on the disk.
    """
    digest = hashlib.sha256(sys.version.encode() + platform.python_implementation().encode())
    own = Path(__file__).parents[1]
    sources = sorted(own.rglob("*.py"))
    if not sources:
        raise DoubtError("the sources of aleator cannot be read")
    for path in sources:
        status = path.stat()
        if max(status.st_mtime, status.st_ctime) > _BEGAN:
            raise DoubtError(f"{path.name} of aleator has changed since this run began")
        digest.update(str(path.relative_to(own)).encode() + b"\0" + path.read_bytes() + b"\0")
    for name in _TRACING:
        try:
            digest.update(f"{name} {metadata.version(name)}\n".encode())
        except metadata.PackageNotFoundError:
            digest.update(f"no {name}\n".encode())
    return digest.hexdigest()


def _texts(it: Any) -> Iterator[str]:
    """The structure of a tree, without the numbers of traced arrays, and the code of a user's objects."""
    if isinstance(it, jax.Array | jax.ShapeDtypeStruct):
        yield f"array {it.shape} {it.dtype} {it.weak_type}"
    elif isinstance(it, np.ndarray | np.generic):
        yield f"constant {_constant(it)}"
    elif isinstance(it, _PLAIN) and type(it) in _PLAIN:
        yield f"{type(it).__name__} {it.hex() if isinstance(it, float) else repr(it)}"
    elif isinstance(it, enum.Enum):
        yield f"{_name_of(type(it))}.{it.name}"
    elif isinstance(it, type):
        yield _name_of(it)
    elif isinstance(it, types.FunctionType):
        # A reading covers a user's code; it does not enter libraries.
        yield from _named(it) if is_library(it.__module__) else [f"function {_name_of(it)}"]
    elif isinstance(it, frozenset | set):
        yield f"{type(it).__name__} {sorted(' '.join(_texts(one)) for one in it)}"
    else:
        yield from _compound(it)


def _compound(it: Any) -> Iterator[str]:
    yield f"{_name_of(type(it))}("
    if isinstance(it, eqx.Module) or (dataclasses.is_dataclass(it) and not isinstance(it, type)):
        parts: Iterable[tuple[Any, Any]] = vars(it).items()
    elif isinstance(it, dict):
        parts = it.items()
    elif isinstance(it, tuple | list):
        parts = enumerate(it)
    elif is_library(type(it).__module__) and getattr(it, "__dict__", None) == {}:
        parts = ()  # a mark, such as Equinox's for a field that is missing
    else:
        raise DoubtError(f"it holds an object of {_name_of(type(it))}")
    for name, value in parts:
        yield from _texts(name)
        yield from _texts(value)
    yield ")"


def _name_of(it: Any) -> str:
    return f"{it.__module__}.{it.__qualname__}"


def _constant(array: Any) -> str:
    """Shape, type and values of an array, which has nothing else."""
    if array.dtype.hasobject or not (type(array) is np.ndarray or isinstance(array, np.generic)):
        raise DoubtError(f"it holds an array of {_name_of(type(array))} with {array.dtype}")
    return array_digest(array)


def _named(it: Any) -> Iterator[str]:
    """An object of a library, by its name there."""
    module, name = getattr(it, "__module__", None), getattr(it, "__qualname__", getattr(it, "__name__", ""))
    if isinstance(it, np.ufunc):
        module = "numpy"
    if not isinstance(module, str) or not is_library(module):
        raise DoubtError(_unnamed(it))
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    if found is not it:
        raise DoubtError(_unnamed(it))
    yield f"{module}:{name}"


def _unnamed(it: Any) -> str:
    return f"{_name_of(type(it))} '{getattr(it, '__qualname__', '')}' is known to one run alone"


def _read(reading: Reading) -> Iterator[str]:
    """A reading as texts."""
    if reading.doubts:
        raise DoubtError(_told(reading.doubts))
    for place, token in reading.reads:
        yield f"{place.who}\t{place.kind}\t{place.name}"
        try:
            yield from _token(token)
        except DoubtError:
            raise DoubtError(_told([place])) from None


def _written(place: Place, token: Any) -> list[str]:
    """What is read at a place as texts, or the place alone."""
    head = f"{place.who}\t{place.kind}\t{place.name}"
    try:
        return [head, *_token(token)]
    except Exception:  # besides doubts: a user's object may raise any if it is looked at
        return [head]


def _told(places: Sequence[Place], most: int = 3) -> str:
    said = ", ".join(str(one) for one in places[:most])
    return said + (f", and {len(places) - most} more" if len(places) > most else "")


def _token(token: Any) -> Iterator[str]:
    if isinstance(token, str):
        yield token
    elif isinstance(token, Plain):
        yield _name_of(token.kind)
        # Of a user's kind of number, say, whose class is read too.
        base: Any = next((one for one in _PLAIN if isinstance(token.value, one)), token.kind)
        known = token.kind in _PLAIN or isinstance(token.value, enum.Enum | tuple)
        yield from _texts(token.value) if known else [token.text or base.__repr__(token.value)]
    elif isinstance(token, Again):
        yield f"again {token.order}"
    elif isinstance(token, Same):
        yield from _same(token.it)
    else:
        raise DoubtError(_unnamed(token))


def _same(it: Any) -> Iterator[str]:
    """An object that is equal only to itself."""
    if isinstance(it, types.CodeType):
        yield from _code(it)
    elif isinstance(it, types.ModuleType):
        yield f"module {it.__name__}"
    elif isinstance(it, type):
        yield _name_of(it)
    elif isinstance(it, jax.Array):
        yield array_digest(it)
    elif isinstance(it, enum.Enum):
        yield f"{_name_of(type(it))}.{it.name}"
    elif isinstance(it, WRAPPERS) and not is_library(it.__module__):
        yield from _wrapper(it)
    elif isinstance(it, logging.Logger):
        yield f"logger {it.name}"
    elif isinstance(it, _OF_NAMED_TUPLE):
        yield from _texts(it.__reduce__()[1])
    elif isinstance(it, types.BuiltinFunctionType) and isinstance(it.__self__, type):
        yield f"{_name_of(it.__self__)}.{it.__name__}"
    elif (owner := getattr(it, "__objclass__", None)) is not None:
        yield f"{_name_of(owner)}.{getattr(it, '__name__', '')}"
    elif type(it) is object:
        yield _mark(it)
    else:
        yield from _named(it)


def _wrapper(it: Any) -> Iterator[str]:
    """What a compiled or remembering function adds to the one inside, which is read for itself."""
    yield _name_of(type(it))
    if hasattr(it, "cache_parameters"):
        yield from _texts(it.cache_parameters())
    else:
        known = it.__getstate__()
        yield f"{known['static_argnums']} {known['static_argnames']} {known['global_cache_key']}"


def _mark(it: object) -> str:
    """A bare object, such as the one by which JAX marks a missing name, by its name in a library."""
    modules = ((name, module) for name, module in list(sys.modules.items()) if is_library(name))
    places = (f"{module}:{name}" for module, one in modules for name, value in list(vars(one).items()) if value is it)
    if found := min(places, default=""):
        return found
    raise DoubtError(_unnamed(it))


def _code(code: types.CodeType) -> Iterator[str]:
    """The parts of a function's code that affect what it computes: neither lines nor files."""
    yield f"{code.co_code.hex()} {code.co_exceptiontable.hex()} {code.co_flags}"
    yield f"{code.co_argcount} {code.co_posonlyargcount} {code.co_kwonlyargcount}"
    yield f"{code.co_names} {code.co_varnames} {code.co_freevars} {code.co_cellvars}"
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _code(constant)
        else:
            yield from _texts(constant)
