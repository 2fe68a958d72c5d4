"""Everything that code reads besides its arguments (globals, closures, class attributes), found without running it.

JAX traces a function once and keeps the values that it read. Two readings of the code show whether these are current:
every name in a function is looked up as Python would do, and the object found is read in turn. A reading covers more
than the code uses. So equal readings prove that nothing has changed, while different ones prove nothing, and the code
must be traced again. Anything that cannot be read, such as the state of a random number generator, is a doubt.
Libraries are presumed not to change; names in them that are bound to other objects now are detected.
"""

import contextlib
import enum
import functools
import importlib.util
import logging
import operator
import sys
import types
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from decimal import Decimal
from fractions import Fraction
from typing import Any, final
from weakref import WeakKeyDictionary

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from aleator._core.arrays import Pytree, is_number
from aleator._core.bytecode import names_in
from aleator._core.contents import array_parts, is_of_c, memory
from aleator._core.equations import array_digest, equations_text
from aleator._core.libraries import HIDDEN, MOODY_NAMES, is_library, is_moody, may_vary, reaches
from aleator._core.readings import Again, Place, Plain, Reading, Same

# Most objects of a reading: larger programs are not read to the end.
_MOST = 5_000
# Functions that remember what they found; JAX's own have this type too.
WRAPPERS = (type(jax.jit(lambda: None)), functools._lru_cache_wrapper)
_DISPATCHED = type(np.sum)
_PLAIN = (str, bytes, int, bool, complex, type(None), type(Ellipsis), range, Decimal, Fraction, np.dtype)
_WITHOUT_CODE = (float, *_PLAIN)
_DESCRIPTORS = (
    types.MemberDescriptorType,
    types.GetSetDescriptorType,
    types.WrapperDescriptorType,
    types.MethodDescriptorType,
    type(Place.who),  # a field of a named tuple
)
# Methods of every named tuple.
_OF_NAMED_TUPLES = {
    getattr(one, "__func__", one).__code__
    for one in (vars(Place)[name] for name in ("_make", "_replace", "__repr__", "_asdict", "__getnewargs__"))
}
_SEQUENCES = (tuple, list, set, frozenset)
_BOOKKEEPING = {
    *("__doc__", "__module__", "__dict__", "__weakref__", "__annotations__", "__annotate_func__", "__qualname__"),
    *("__abstractmethods__", "_abc_impl", "__abstractvars__", "__abstractclassvars__", "__slots__", "__match_args__"),
    *("__dataclass_params__", "__dataclass_fields__", "__parameters__", "__orig_bases__", "__static_attributes__"),
    *("__firstlineno__", "__annotations_cache__", "__slotnames__"),
    # Of enumerations; they grow with the use of flags.
    *("_value2member_map_", "_unhashable_values_", "_hashable_values_", "_unhashable_values_map_"),
}
_OF_MODULES = {
    *("__builtins__", "__cached__", "__doc__", "__file__", "__loader__", "__name__", "__package__", "__path__"),
    *("__spec__", "__annotations__", "__warningregistry__"),
}


def read_code(tree: Pytree) -> Reading:
    """A reading of the code in a tree: its modules' classes, and the functions and objects that it holds.

    Numbers and arrays of the tree are data, not part of its code.
    """
    reader = _Reader()
    reader.data(tree, Place(type(tree).__name__, "attribute", ""))
    return Reading(tuple(reader.reads), tuple(dict.fromkeys(reader.doubts)))


def told_apart(function: Callable[..., Pytree], *arguments: Pytree) -> Hashable:
    """Equal for arguments whose code makes `function` compute the same: a reading of it, or the traced equations."""
    reading = read_code(arguments)
    if not reading.doubts:
        return reading.reads
    numbers, rest = eqx.partition(arguments, eqx.is_array)
    closed = jax.make_jaxpr(lambda numbers: function(*eqx.combine(numbers, rest)))(numbers)
    return equations_text(closed), tuple(map(array_digest, closed.consts)), reading.reads


# The first readings in this process of functions inside `jax.jit` or `functools.lru_cache`.
_FIRST: "WeakKeyDictionary[Any, tuple[Any, ...]]" = WeakKeyDictionary()


@final
class _Reader:
    """Reads each object once, depth first."""

    def __init__(self, *, checks: bool = True) -> None:
        self._checks = checks  # whether functions that remember are compared with their first readings
        self.reads: list[tuple[Place, Any]] = []
        self.doubts: list[Place] = []
        # Objects already read are kept alive, because an address can be reused; each with its number in the order.
        self._seen: dict[int, tuple[Any, int]] = {}
        self._classes: set[type] = set()

    def _is_new(self, it: Any) -> bool:
        if id(it) in self._seen:
            return False
        self._seen[id(it)] = it, len(self._seen)
        return True

    def data(self, it: Any, place: Place) -> None:
        """A part of a tree whose numbers are data."""
        if isinstance(it, _WITHOUT_CODE):
            return
        if isinstance(it, eqx.Module):
            self._class(type(it))
            name, fields = type(it).__name__, type(it).__dataclass_fields__  # type: ignore[attr-defined]
            for field, value in vars(it).items():
                if isinstance(value, _WITHOUT_CODE):
                    continue  # data, or structure such as the steps of a grid
                static = field not in fields or fields[field].metadata.get("static", False)
                (self.value if static else self.data)(value, Place(name, "attribute", field))
        elif isinstance(it, tuple | list | dict):
            self._class(type(it))
            for part in it.values() if isinstance(it, dict) else it:
                self.data(part, place)
        elif not is_number(it):
            self.value(it, place)

    def value(self, it: Any, place: Place) -> None:
        """Anything that is read by its value."""
        if isinstance(it, _WITHOUT_CODE):
            self._class(type(it))
            self.reads.append((place, Plain(type(it), it, it.hex() if isinstance(it, float) else "")))
            if type(it) not in _WITHOUT_CODE and self._is_new(it):
                self._attributes(it, place)
        elif isinstance(it, types.ModuleType):
            self._module(it, place, ())
        elif len(self._seen) > _MOST:
            self.doubts.append(place)
        elif self._is_new(it):
            self._compound(it, place)
        else:
            self.reads.append((place, Again(it, self._seen[id(it)][1])))

    def _compound(self, it: Any, place: Place) -> None:
        self._class(type(it))
        if isinstance(it, types.FunctionType):
            self._function(it, place)
        elif isinstance(it, type):
            self._known(it, place, doubtful=is_moody(it.__module__) or reaches(it))
            self._class(it)
        elif isinstance(it, np.ndarray | np.generic):
            self._array(it, place)
        elif isinstance(it, Tracer):
            self.doubts.append(place)
        elif isinstance(it, jax.Array):
            self.reads.append((place, Same(it)))
        elif isinstance(it, enum.Enum):
            self.reads.append((place, Same(it)))
            if not is_library(type(it).__module__):
                self._attributes(it, place)
        elif it is sys.modules:
            self.doubts.append(place)
        elif isinstance(it, _SEQUENCES):
            self.reads.append((place, Plain(type(it), len(it))))
            self._all(it, place)
            self._attributes(it, place)
        elif isinstance(it, Mapping) and hasattr(it, "items"):
            self.reads.append((place, Plain(type(it), len(it))))
            self._all((part for item in list(it.items()) for part in item), place)
            self._all([it.default_factory] if isinstance(it, defaultdict) else [], place)
            self._attributes(it, place)
        elif isinstance(it, types.MethodType):
            self._all((it.__func__, it.__self__), place)
        elif isinstance(it, property):
            self._all((it.fget,), place)
        elif isinstance(it, staticmethod | classmethod):
            self._all((it.__func__,), place)
        elif isinstance(it, functools.cached_property):
            self._all((it.func,), place)
        elif isinstance(it, functools.partial):
            self._all((it.func, it.args, it.keywords), place)
        elif isinstance(it, operator.itemgetter):
            self.reads.append((place, Same(type(it))))
            self._all(it.__reduce__()[1], place)
        elif isinstance(it, types.BuiltinFunctionType | types.MethodWrapperType):
            self._builtin(it, place)
        elif isinstance(it, (*_DESCRIPTORS, logging.Logger)) or type(it) is object:
            self._known(it, place, doubtful=False)
        elif isinstance(it, np.ufunc):
            self._known(it, place, doubtful=all("O" in one for one in it.types))
        else:
            self._object(it, place)

    def _all(self, parts: Any, place: Place) -> None:
        for part in parts:
            self.value(part, place)

    def _known(self, it: Any, place: Place, *, doubtful: bool) -> None:
        """Something that is unchanged as long as it is the same object."""
        self.reads.append((place, Same(it)))
        if doubtful:
            self.doubts.append(place)

    def _array(self, it: Any, place: Place) -> None:
        """An array with all that its own kind adds, such as a mask."""
        self.reads.append((place, Plain(tuple, it.shape)))
        numbers, added = array_parts(it)
        for one in numbers:
            if one.dtype.hasobject:
                self._all(one.ravel().tolist(), place)
            else:
                self.reads.append((place, array_digest(one)))
        for name, value in added.items():
            self.value(value, Place(place.who, place.kind, f"{place.name}.{name}"))

    def _builtin(self, it: Any, place: Place) -> None:
        owner = it.__self__
        module = getattr(it, "__module__", None)
        hidden = module == "builtins" and it.__name__ in HIDDEN
        self._known(it, place, doubtful=hidden or may_vary(it, module))
        if owner is not None and not isinstance(owner, types.ModuleType):
            self.value(owner, place)

    def _object(self, it: Any, place: Place) -> None:
        kind = type(it)
        module = getattr(it, "__module__", None)
        if isinstance(it, WRAPPERS):
            self._known(it, place, doubtful=False)
            if not is_library(module):
                self._wrapped(it, place)
        elif isinstance(it, _DISPATCHED) and is_library(module):
            self._known(it, place, doubtful=may_vary(it, module))
        elif hasattr(it, "__name__") and is_library(module) and kind.__module__.startswith("jax"):
            self._known(it, place, doubtful=is_moody(module))
        elif is_of_c(it):
            held = memory(it)
            self.reads.append((place, Plain(kind, held)))
            self.doubts += [place] if held is None else []
        elif is_moody(kind.__module__) or not _has_attributes(it):
            self._known(it, place, doubtful=True)
        else:
            self.reads.append((place, Same(kind)))
            self._attributes(it, place)

    def _wrapped(self, it: Any, place: Place) -> None:
        """The function inside `jax.jit` or `functools.lru_cache`. They remember values from before a change in it."""
        inner = it.__wrapped__
        self.value(inner, place)
        if not self._checks:
            return
        alone = _Reader(checks=False)
        alone.value(inner, place._replace(who="", name=""))
        if _FIRST.setdefault(it, tuple(alone.reads)) != tuple(alone.reads):
            self.doubts.append(place)

    def _attributes(self, it: Any, place: Place) -> None:
        for name, value in list(getattr(it, "__dict__", {}).items()):
            if isinstance(it, enum.Enum) and name.startswith("_") and name != "_value_":
                continue
            self.value(value, Place(place.who, place.kind, f"{place.name}.{name}"))
        for kind in type(it).__mro__:
            slots = vars(kind).get("__slots__", ())
            for name in (slots,) if isinstance(slots, str) else slots:
                self.value(getattr(it, name, None), place)

    def _class(self, it: type) -> None:
        """All that a class and its bases define."""
        for kind in it.__mro__:
            if kind in self._classes or is_library(kind.__module__):
                continue
            self._classes.add(kind)
            self.reads.append((Place(kind.__qualname__, "attribute", "__mro__"), Same(kind)))
            for name, value in list(vars(kind).items()):
                if name not in _BOOKKEEPING:
                    self.value(value, Place(kind.__qualname__, "attribute", name))

    def _function(self, it: types.FunctionType, place: Place) -> None:
        home = it.__globals__.get("__name__")
        if it.__code__ in _OF_NAMED_TUPLES:
            self.reads.append((place, Same(it.__code__)))
            return
        if is_library(home) and is_library(it.__module__) and "<locals>" not in it.__qualname__:
            self._known(it, place, doubtful=may_vary(it, home))
            return
        who = it.__qualname__
        self.reads.append((Place(who, "code", ""), Same(it.__code__)))
        for name, default in [*enumerate(it.__defaults__ or ()), *(it.__kwdefaults__ or {}).items()]:
            self.value(default, Place(who, "default", str(name)))
        cells = dict(_contents(it))
        for name, content in cells.items():
            # Of a module, what is read follows from the names in the code.
            if is_library(home) or not isinstance(content, types.ModuleType):
                self.value(content, Place(who, "closure variable", name))
        self._attributes(it, Place(who, "attribute", ""))
        if not is_library(home):
            self._names(it, who, cells)

    def _names(self, it: types.FunctionType, who: str, cells: Mapping[str, Any]) -> None:
        chains, attributes, loose, _ = names_in(it.__code__)
        known, builtins = it.__globals__, it.__builtins__  # type: ignore[attr-defined]
        begun = set[str]()
        for chain in chains:
            place = Place(who, chain.kind, chain.name)
            if chain.kind == "module":
                name = _absolute(chain.name, known.get("__package__"))
                if name in sys.modules:
                    self._follow(sys.modules[name], place._replace(name=name), chain.attributes, loose)
            elif chain.kind == "closure variable":
                if isinstance(cells.get(chain.name), types.ModuleType):
                    self._follow(cells[chain.name], place, chain.attributes, loose)
            elif chain.name in known:
                if isinstance(known[chain.name], types.ModuleType) or chain.name not in begun:
                    self._follow(known[chain.name], place, chain.attributes, loose)
                begun.add(chain.name)
            elif chain.name in HIDDEN and chain.name in builtins:
                self.doubts.append(Place(who, "name", chain.name))
        self.doubts += [Place(who, "name", name) for name in attributes if name in MOODY_NAMES]

    def _follow(self, it: Any, place: Place, attributes: Iterable[str], loose: tuple[str, ...]) -> None:
        """The object at the end of a chain; from the first on that is no module, attributes are the object's own."""
        for name in attributes:
            if not isinstance(it, types.ModuleType):
                break
            self.reads.append((place, Same(it)))
            further = Place(place.who, "global", f"{place.name}.{name}")
            if is_moody(it.__name__):
                self.doubts.append(place)
                return
            if is_moody(f"{it.__name__}.{name}") or (name == "__dict__" and is_library(it.__name__)):
                self.doubts.append(further)
                return
            if is_library(it.__name__):
                with contextlib.suppress(Exception):  # what its code would raise too, when it runs
                    getattr(it, name)  # a part that is loaded at its first use reads as it will after that
            if name not in vars(it):  # all of it, for whatever makes the attribute
                break
            it, place = vars(it)[name], further
        if isinstance(it, types.ModuleType):
            self._module(it, place, loose)
        else:
            self.value(it, place)

    def _module(self, it: types.ModuleType, place: Place, loose: tuple[str, ...]) -> None:
        """A module that may go anywhere: a user's is read as a whole, of a library's what is `loose` in the code."""
        self.reads.append((place, Same(it)))
        if is_moody(it.__name__):
            self.doubts.append(place)
        elif is_library(it.__name__):
            for name in loose:
                if name in vars(it) and vars(it)[name] is not it:
                    rest = tuple(one for one in loose if one != name)
                    self._follow(vars(it)[name], Place(place.who, "global", f"{place.name}.{name}"), (), rest)
        elif self._is_new(it):
            self._class(type(it))
            for name, value in list(vars(it).items()):
                if name not in _OF_MODULES:
                    self.value(value, Place(it.__name__, "global", name))


def _absolute(name: str, package: str | None) -> str:
    try:
        return importlib.util.resolve_name(name, package)
    except (ImportError, ValueError):  # the function cannot import it either
        return name


def _has_attributes(it: Any) -> bool:
    return hasattr(it, "__dict__") or any("__slots__" in vars(one) for one in type(it).__mro__)


def _contents(it: types.FunctionType) -> Iterator[tuple[str, Any]]:
    """The closure variables of a function by name, without those that are empty as yet."""
    for name, cell in zip(it.__code__.co_freevars, it.__closure__ or (), strict=True):
        with contextlib.suppress(ValueError):
            yield name, cell.cell_contents
