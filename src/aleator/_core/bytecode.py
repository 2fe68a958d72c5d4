"""The names in a function's code, from its bytecode: which attributes it looks up in which globals, one after another.

`jnp.sqrt(self.load)` looks `sqrt` up in the global `jnp`, and `load` in an argument: never `jnp.load`.
"""

import dis
import functools
import types
from collections import Counter
from typing import Any, NamedTuple, final

# Loads of globals; in bodies of classes too. The last two are those of Python 3.12 and later.
_GLOBAL = {"LOAD_GLOBAL", "LOAD_NAME", "STORE_GLOBAL", "DELETE_GLOBAL", "LOAD_FROM_DICT_OR_GLOBALS"}
_CELL = {"LOAD_DEREF", "LOAD_CLASSDEREF", "LOAD_FROM_DICT_OR_DEREF"}
_ATTRIBUTE = {"LOAD_ATTR", "LOAD_METHOD", "STORE_ATTR", "DELETE_ATTR"}
_NOTHING = {"EXTENDED_ARG", "NOP", "CACHE", "PRECALL", "PUSH_NULL", "NOT_TAKEN"}
# What follows `import a.b as c` before it is stored.
_SHUFFLE = {"SWAP", "ROT_TWO", "POP_TOP"}


class Chain(NamedTuple):
    """A name and the attributes looked up from it on: `jnp.linalg.norm` is the global `jnp` with two attributes.

    `kind`: "global", "closure variable", or "module" if the function itself imports it; `name` then is the module's,
    with leading dots if it is relative.
    """

    kind: str
    name: str
    attributes: tuple[str, ...] = ()

    def then(self, attribute: str) -> "Chain":
        """The chain with one more attribute."""
        return self._replace(attributes=(*self.attributes, attribute))


class Names(NamedTuple):
    """The names in a function's code, inner functions included.

    - `chains`: each as far as it can be followed; what it leads to may go anywhere from there;
    - `attributes`: all that are looked up; `loose`: those looked up in something computed, perhaps a module;
    - `owned`: those looked up in an argument, which may be a module only to whoever calls the function.
    """

    chains: tuple[Chain, ...]
    attributes: tuple[str, ...]
    loose: tuple[str, ...]
    owned: tuple[str, ...]


@functools.lru_cache(maxsize=4096)
def names_in(code: types.CodeType) -> Names:
    """The names in a function's code."""
    scan = _Scan(code)
    for one in code.co_consts:
        if isinstance(one, types.CodeType):
            scan.inner(names_in(one))
    found: Any = (scan.chains, scan.attributes, scan.loose, scan.owned)
    return Names(*(tuple(dict.fromkeys(one)) for one in found))


@final
class _Scan:
    """One pass over the instructions; `_top` is what the last one left: a chain, an argument or neither."""

    def __init__(self, code: types.CodeType):
        self.chains: list[Chain] = []
        self.attributes: list[str] = []
        self.loose: list[str] = []
        self.owned: list[str] = []
        self._code, self._instructions = code, list(dis.get_instructions(code))
        arguments = code.co_argcount + code.co_kwonlyargcount + bool(code.co_flags & 4) + bool(code.co_flags & 8)
        stored = Counter(name for one in self._instructions if "STORE" in one.opname for name in _locals(one))
        self._arguments = {name for name in code.co_varnames[:arguments] if not stored[name]}
        # Locals that stand for one chain, such as `xp` in `xp = jnp`: bound once, and no argument.
        self._single = {name for name, times in stored.items() if times == 1} - set(code.co_varnames[:arguments])
        self._aliases: dict[str, Chain] = {}
        self._loaded = set[str]()
        self._top: Chain | bool | None = None  # True: an argument, or an attribute of one
        self._imported: Chain | None = None
        self._renames = False  # between the loads of `import a.b as c`
        for number, one in enumerate(self._instructions):
            if one.opname not in _NOTHING:
                self._step(number, one)
        self._settle()

    def inner(self, names: Names) -> None:
        """The names of an inner function; its closure variables may be locals of this one."""
        self.attributes += names.attributes
        self.loose += names.loose + names.owned
        for chain in names.chains:
            if chain.kind != "closure variable" or chain.name in self._code.co_freevars:
                self.chains.append(chain)
            else:
                (self.owned if chain.name in self._arguments else self.loose).extend(chain.attributes)

    def _settle(self) -> None:
        """Whatever was on top is used in a way that is not followed."""
        if isinstance(self._top, Chain):
            self.chains.append(self._top)
        self._top = None

    def _step(self, number: int, one: dis.Instruction) -> None:
        name, operation = one.argval, one.opname
        if one.is_jump_target:  # another path may have left something else there
            self._settle()
            self._imported = None
        if operation in _ATTRIBUTE:
            self._attribute(name)
            if operation not in ("LOAD_ATTR", "LOAD_METHOD"):
                self._settle()
        elif operation == "IMPORT_FROM":
            if self._top != self._imported:
                self._settle()
            self._top = self._imported.then(name) if self._imported else None
            self._renames = True
            return
        elif operation in _SHUFFLE and self._renames and isinstance(self._top, Chain):
            self._imported = self._top
            return
        elif operation == "STORE_FAST" and isinstance(self._top, Chain) and name in self._single - self._loaded:
            self._aliases[name], self._top = self._top, None
        else:
            self._settle()
            self._begin(number, one)
            if operation in ("STORE_GLOBAL", "DELETE_GLOBAL"):
                self._settle()
        self._renames = False

    def _attribute(self, name: str) -> None:
        self.attributes.append(name)
        if isinstance(self._top, Chain):
            self._top = self._top.then(name)
        else:
            (self.owned if self._top else self.loose).append(name)

    def _begin(self, number: int, one: dis.Instruction) -> None:
        """What an instruction leaves on top, beginning anew."""
        name, operation = one.argval, one.opname
        if operation in _GLOBAL:
            self._top = Chain("global", name)
        elif operation in _CELL and name in self._code.co_freevars:
            self._top = Chain("closure variable", name)
        elif operation in _CELL:
            self._top = name in self._arguments or None
        elif operation == "IMPORT_NAME":
            self._imported = self._top = _imported(name, self._instructions[:number])
        elif "LOAD_FAST" in operation:
            self._loaded |= {*_locals(one)} - {*self._aliases}  # before it was bound, as in a loop
            local = _locals(one)[-1]
            self._top = self._aliases.get(local) or local in self._arguments or None


def _locals(one: dis.Instruction) -> tuple[str, ...]:
    """The names of local variables in an instruction; some of Python 3.13 and later have two."""
    return one.argval if isinstance(one.argval, tuple) else (one.argval,)


def _imported(name: str, before: list[dis.Instruction]) -> Chain:
    """What `IMPORT_NAME` leaves: the module whose names are imported, or else the outermost package."""
    level, names = [one.argval for one in before if one.opname not in _NOTHING][-2:]
    return Chain("module", "." * level + (name if names or level else name.partition(".")[0]))
