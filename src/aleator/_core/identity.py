"""Digests, valid in every process, of what a compiled program or a result follows from.

A declared problem is told by the digest of its equations, and this package and the libraries by their versions. Code
is read only where there are no equations: a user's classes in a problem, black boxes, and work that a journal keeps;
with the values that it takes from outside. What cannot be written out is a doubt: then a program is traced, and a
result computed, anew.
"""

import dataclasses
import enum
import functools
import hashlib
import os
import platform
import sys
import sysconfig
import time
import types
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from decimal import Decimal
from fractions import Fraction
from importlib import metadata
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
import scipy

from aleator._core.equations import TracedFunction, array_digest
from aleator._core.leaves import Module
from aleator._core.parallel import CORES

# Libraries that trace and compile.
_TRACING = ("jax", "jaxlib", "equinox", "numpy", "scipy")
_LIBRARIES = {"aleator", "aleator_command", "jaxtyping", *_TRACING}
_PYTHON = sysconfig.get_path("stdlib")
_INSTALLED = sysconfig.get_path("purelib"), sysconfig.get_path("platlib")
_PLAIN = (str, bytes, int, bool, float, complex, type(None), type(Ellipsis), range, Decimal, Fraction, np.dtype)
# Settings of JAX that do not affect a program.
_ASIDE = ("jax_compilation_cache_dir", "jax_persistent_cache", "jax_raise_persistent", "jax_log", "jax_explain")
# Environment variables that affect compilation begin with these.
_VARIABLES = ("XLA_", "TF_XLA_", "LIBTPU_", "EQX_")
_BEGAN = time.time()
_PROCESSOR = Path("/proc/cpuinfo")


class DoubtError(Exception):
    """Something has no text that identifies it in other processes."""


def lasting_name(function: Callable[..., Any], arguments: tuple[Any, ...], *how: Any) -> str | None:
    """A name for one of our functions, traced for arguments of one structure and compiled in some way.

    Programs of the same name compute the same, in any process; None if that is uncertain, as it is for arguments with a
    user's code outside a declared problem. The numbers of arrays are not part of it.
    """
    try:
        return joined([_surroundings(), *_Texts()((function, how)), *_Texts(whole=False)(arguments)])
    except Exception:  # besides doubts: a user's object may raise any if it is looked at, and may hold itself
        return None


def lasting_digest(it: Any, *, declared: bool = False) -> str:
    """A digest of an object, numbers included; `declared`: without its code, which the digest of equations tells.

    Raises `DoubtError` if it cannot be written out.
    """
    try:
        return joined(_Texts()(it, declared=declared))
    except DoubtError:
        raise
    except Exception as error:  # a user's object may raise any if it is looked at, and may hold itself
        raise DoubtError(f"looking at it raises {type(error).__name__}: {error}") from error


def identity_of(tree: Any) -> str | None:
    """A digest of a tree with all code and numbers in it, and what the code names; None if it cannot be written out."""
    try:
        return lasting_digest(tree)
    except DoubtError:
        return None


def joined(texts: Iterable[str]) -> str:
    """A digest of texts."""
    return hashlib.sha256("\0".join(texts).encode(errors="surrogatepass")).hexdigest()


@functools.lru_cache(maxsize=4096)
def is_library(module: Any) -> bool:
    """Whether a module, by its name, is part of Python, of this package or of the libraries that trace for it."""
    if not isinstance(module, str):
        return False
    root = module.partition(".")[0]
    if root in _LIBRARIES:
        return True
    # A user's module may have the name of one of Python's.
    file = getattr(sys.modules.get(root), "__file__", None)
    return root in sys.stdlib_module_names and (file is None or file.startswith(_PYTHON))


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
    machine = [device.client.platform_version, device.device_kind, f"cores={CORES}", *_processor()]
    return "\n".join([versions(), jax.default_backend(), *machine, *settings])


@functools.cache
def _processor() -> list[str]:
    """What tells kinds of machines apart: code for one processor may crash on another."""
    about = [platform.system(), platform.machine(), platform.processor()]
    try:
        lines = _PROCESSOR.read_text().split("\n\n")[0].splitlines()
    except OSError:
        return [*about, platform.node()]  # Nothing tells what its processor can do: a machine of its own.
    return about + [line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))]


@functools.cache
def versions() -> str:
    """A digest of this package's sources and of the versions of libraries that trace, of which all results are.

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


class _Texts:
    """A tree as texts.

    - `whole`: whether numbers of JAX are written too, which programs take as arguments, and a user's code outside a
      declared problem, which is a doubt otherwise.
    """

    def __init__(self, *, whole: bool = True):
        self._whole = whole
        self._known = set[Any]()  # functions and classes that have been written

    def __call__(self, it: Any, *, declared: bool = False) -> Iterator[str]:
        """The texts of an object; `declared`: within a problem, the digest of whose equations covers its code."""
        if isinstance(it, jax.Array) and self._whole:
            yield f"constant {array_digest(it)}"
        elif isinstance(it, jax.Array | jax.ShapeDtypeStruct):
            yield f"array {it.shape} {it.dtype} {it.weak_type}"
        elif isinstance(it, np.ndarray | np.generic):
            yield f"constant {_constant(it)}"
        elif isinstance(it, _PLAIN) and type(it) in _PLAIN:
            yield f"{type(it).__name__} {it.hex() if isinstance(it, float) else repr(it)}"
        elif isinstance(it, enum.Enum):
            yield f"{_name_of(type(it))}.{it.name}"
            yield from self({name: value for name, value in vars(it).items() if name != "__objclass__"})
        elif isinstance(it, type | types.FunctionType | types.BuiltinFunctionType | np.ufunc):
            yield from self._code(it, declared)
        elif isinstance(it, types.MethodType):
            yield from self((it.__func__, it.__self__), declared=declared)
        elif isinstance(it, frozenset | set):
            yield f"{type(it).__name__} {sorted(' '.join(self(one, declared=declared)) for one in it)}"
        elif isinstance(it, types.ModuleType):
            yield f"module {it.__name__}"
            if not is_library(it.__name__) and (file := getattr(it, "__file__", None)):
                yield hashlib.sha256(Path(file).read_bytes()).hexdigest()
        elif callable(getattr(it, "__wrapped__", None)) and is_library(type(it).__module__):
            # Of `jax.jit`, `lru_cache`, or `jax.custom_jvp` with its rule.
            aside = {"cache_parameters", *(name for name in vars(it) if name.startswith("__"))}
            parts = {name: value for name, value in vars(it).items() if name not in aside}
            wrapped: Any = it.__wrapped__  # type: ignore[union-attr]
            yield from (_name_of(type(it)), *self(wrapped, declared=declared), *self(parts, declared=declared))
        else:
            yield from self._compound(it, declared)

    def _compound(self, it: Any, declared: bool) -> Iterator[str]:
        declared = declared or (isinstance(it, Module) and it.is_declared)
        yield from self._code(type(it), declared)
        if isinstance(it, eqx.Module):
            # In one order, whether it was made or changed as a tree.
            parts: Iterable[tuple[Any, Any]] = sorted(vars(it).items())
        elif type(it) in (dict, OrderedDict):
            # A user's code may depend on their order, which JAX does not keep.
            parts = it.items() if self._whole and not declared else sorted(it.items(), key=lambda item: repr(item[0]))
        elif type(it) in (tuple, list):
            parts = enumerate(it)
        elif isinstance(it, TracedFunction):
            if not it.digest.is_whole:
                raise DoubtError("its equations call Python code")
            parts = [("digest", it.digest.text)]
        elif dataclasses.is_dataclass(it) and is_library(type(it).__module__):
            parts = [(one.name, getattr(it, one.name)) for one in dataclasses.fields(it) if one.compare]
        else:
            parts = enumerate(_made_by(it))
        for name, value in parts:
            yield from self(name)
            yield from self(value, declared=declared)
        yield ")"

    def _code(self, it: Any, declared: bool) -> Iterator[str]:
        """A class or function: by its name if its code is known otherwise, else by all of it."""
        yield f"{_name_of(it)}("
        if isinstance(it, np.ufunc):
            if getattr(np, it.__name__, None) is not it and getattr(scipy.special, it.__name__, None) is not it:
                raise DoubtError(f"{_name_of(it)} may call anything")  # of `np.frompyfunc`, or of another library
            return
        if declared or it in self._known:
            return
        if is_library(it.__module__):
            if isinstance(it, types.FunctionType) and "<locals>" in it.__qualname__:
                raise DoubtError(f"{_name_of(it)} may hold anything")
            return
        if not self._whole:
            raise DoubtError(f"{_name_of(it)} is known to one run alone")
        self._known.add(it)
        if isinstance(it, types.FunctionType):
            yield from self._function(it)
        elif isinstance(it, type):
            yield from self._attributes(it)
        else:
            raise DoubtError(f"{_name_of(it)} is not written in Python")

    def _attributes(self, it: type) -> Iterator[str]:
        """What a class defines, its bases, and its own class."""
        yield from self((type(it), it.__bases__))
        for name, value in vars(it).items():
            function = getattr(value, "fget", None) or getattr(value, "__func__", value)
            if isinstance(function, types.FunctionType):
                yield from (name, *(() if is_library(function.__module__) else self(function)))
            elif not name.startswith(("__", "_abc_")) and not isinstance(value, types.MemberDescriptorType):
                yield from (name, *self(value))

    def _function(self, it: types.FunctionType) -> Iterator[str]:
        """A function's code, and what it takes from outside: defaults, closures and globals that it names."""
        yield from self._compiled(it.__code__)
        cells = zip(it.__code__.co_freevars, it.__closure__ or (), strict=True)
        outside = {name: cell.cell_contents for name, cell in cells}
        outside |= {name: it.__globals__[name] for name in _names(it.__code__) if name in it.__globals__}
        yield from self((it.__defaults__, it.__kwdefaults__, vars(it)))
        for name, value in sorted(outside.items()):
            yield name
            try:
                yield from self._of_module(value, _names(it.__code__)) if _is_own(value) else self(value)
            except DoubtError as error:
                raise DoubtError(f"'{name}', which {_name_of(it)} names, cannot be written out: {error}") from None

    def _of_module(self, module: types.ModuleType, names: set[str], within: tuple[Any, ...] = ()) -> Iterator[str]:
        """What code takes from a user's module: the attributes that it names, those of modules in it too."""
        yield from self(module)
        for name in sorted(names & vars(module).keys()):
            value = vars(module)[name]
            if not _is_own(value):
                yield from (name, *self(value))
            elif value not in within:
                yield from (name, *self._of_module(value, names, (*within, module)))

    def _compiled(self, code: types.CodeType) -> Iterator[str]:
        """All of a function's code that affects what it computes: neither its file nor its lines."""
        yield f"{code.co_code.hex()} {code.co_exceptiontable.hex()} {code.co_flags}"
        yield f"{code.co_argcount} {code.co_posonlyargcount} {code.co_kwonlyargcount}"
        yield f"{code.co_names} {code.co_varnames} {code.co_freevars}"
        for constant in code.co_consts:
            yield from self._compiled(constant) if isinstance(constant, types.CodeType) else self(constant)


def _made_by(it: Any) -> list[Any]:
    """What makes an object anew in another process, all of it: slots, items, the number of a kind of `float`."""
    try:
        made = it.__reduce_ex__(4)
    except Exception as error:  # whatever a class raises that cannot be pickled
        raise DoubtError(f"it holds an object of {_name_of(type(it))}") from error
    if isinstance(made, str):
        raise DoubtError(f"it holds {made}, which is known to one run alone")
    return [list(part) if isinstance(part, Iterator) else part for part in made]


def _is_own(it: Any) -> bool:
    """Whether it is a module that is not installed, but a user's."""
    if not isinstance(it, types.ModuleType) or is_library(it.__name__):
        return False
    return not (getattr(it, "__file__", None) or "").startswith(_INSTALLED)


def own_files() -> list[Path]:
    """The files of a user's modules that have been imported, but for the script that runs."""
    own = (one for name, one in [*sys.modules.items()] if name != "__main__" and _is_own(one))
    return sorted({Path(file).resolve() for one in own if (file := getattr(one, "__file__", None))})


def _names(code: types.CodeType) -> set[str]:
    inner = (one for one in code.co_consts if isinstance(one, types.CodeType))
    return {*code.co_names}.union(*map(_names, inner))


def _name_of(it: Any) -> str:
    return f"{it.__module__}.{it.__qualname__}" if hasattr(it, "__qualname__") else f"numpy.{it.__name__}"


def _constant(array: Any) -> str:
    """Shape, type and values of an array, which has nothing else."""
    if array.dtype.hasobject or not (type(array) is np.ndarray or isinstance(array, np.generic)):
        raise DoubtError(f"it holds an array of {_name_of(type(array))} with {array.dtype}")
    return array_digest(array)
