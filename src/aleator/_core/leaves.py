"""Models, for all layers: modules that hold numbers, leaves in the place of one, and the names of places."""

import abc
import dataclasses
import importlib
import inspect
from collections import Counter, OrderedDict
from collections.abc import Callable
from typing import Any, Self, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer
from jax.tree_util import DictKey, GetAttrKey, SequenceKey, keystr, tree_flatten_with_path

from aleator._core.arrays import Pytree
from aleator._core.border import a_name, real_array, refusal, refuse_not_finite
from aleator._core.errors import ProblemError


def in_order(tree: Pytree) -> Pytree:
    """A tree whose dicts, and those in its lists and tuples, keep the order in which they are written.

    JAX sorts the keys of a plain dict wherever it makes a tree anew; a user's code may unpack `values()`.
    """
    if type(tree) is dict:
        tree = {key: in_order(value) for key, value in tree.items()}
        # Keys of different kinds have no order but this one.
        is_sorted = len({*map(type, tree)}) < 2 and [*tree] == sorted(tree)
        return tree if is_sorted else OrderedDict(tree)
    return type(tree)(map(in_order, tree)) if type(tree) in (list, tuple) else tree


class Module(eqx.Module):
    """An Equinox module whose methods are plain ones.

    Equinox makes a module of each method at each access, for those who give methods to compiled functions as arguments.
    Nothing here does, and problems are walked through so often that this took much of the time of small solves.
    """

    __getattribute__ = object.__getattribute__

    def __init_subclass__(cls, **options: Any) -> None:
        """Refuse a field with the name of a method that it would hide, such as the `load` of an `al.Lagrangian`."""
        super().__init_subclass__(**options)
        for name in inspect.get_annotations(cls):
            ours = (base for base in cls.__mro__[1:] if base.__module__.startswith("aleator."))
            hidden = next((base for base in ours if inspect.isfunction(vars(base).get(name))), None)
            if hidden is not None and not callable(vars(cls).get(name)):
                raise ProblemError(
                    f"{cls.__name__}.{name}: {hidden.__name__} has a method of that name, which the field would hide: "
                    "give the field another name."
                )

    def __check_init__(self) -> None:
        """A user's fields keep the order of their dicts."""
        if not type(self).__module__.startswith("aleator."):
            for name, value in vars(self).items():
                object.__setattr__(self, name, in_order(value))

    @property
    def is_declared(self) -> bool:
        """Whether it holds a digest of equations that tells all code in it."""
        return False


class Printed:
    """Something that a notebook shows as a table; `print` shows the same as text."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return _showing().page_of(self)


class _Figures:
    """The figures of a result: `result.plot()` is the usual one, and the methods of `result.plot` are the others.

    Each returns a figure of Plotly. It is a descriptor of its own, not a property, because notebooks complete
    `result.plot.` only if looking it up is no property's code.
    """

    def __get__(self, result: Any, owner: Any = None) -> Any:
        return self if result is None else _showing().plots_of(result)


class Drawn(Printed):
    """A result of which there are figures. Its `repr` is one line, however many numbers it has: `print` shows more."""

    __slots__ = ()

    plot = _Figures()

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "__repr__" not in vars(cls):  # a dataclass would write its own, with every number
            cls.__repr__ = Drawn.__repr__

    def __repr__(self) -> str:
        first, _, _ = str(self).partition("\n")
        return f"<{type(self).__name__}: {' '.join(first.split())}>"


def _showing() -> Any:
    return importlib.import_module("aleator.reporting.drawn")


_Class = TypeVar("_Class", bound=type)


class AbstractLeaf(Module):
    """A distribution or a decision in the place of a number of a model, until realisation replaces it.

    Leaves are recognised by this type alone, so that a model's own classes may have any fields.
    """

    shared_name: eqx.AbstractVar[str | None]

    def shared(self, name: str) -> Self:
        """A copy whose placements are all one number, together with any others shared under this name."""
        return self.with_fields(shared_name=a_name("shared", name))

    def with_fields(self, **changes: Any) -> Self:
        """A copy with other values in the named fields."""
        copy = object.__new__(type(self))
        for field in dataclasses.fields(self):
            object.__setattr__(copy, field.name, changes.get(field.name, getattr(self, field.name)))
        return copy

    @property
    def is_uncertain(self) -> bool:
        """Whether realisations differ: false for decisions and for distributions that are held at their means."""
        return False

    @property
    @abc.abstractmethod
    def shape(self) -> tuple[int, ...]:
        """The shape of the number or array that replaces it in a realisation."""

    @abc.abstractmethod
    def lowest(self) -> float | None:
        """The smallest value of any entry, for every realisation and decision; -inf if unbounded.

        None if unknown because numbers are traced.
        """

    @abc.abstractmethod
    def highest(self) -> float | None:
        """The largest value of any entry, as `lowest`."""


class AbstractPlanned(Module):
    """A model whose realisations may know what it is at the means of its distributions, as a controller does."""

    @abc.abstractmethod
    def beside(self, means: Callable[[], Any]) -> Any:
        """Itself, realised, and what it knows.

        `means`: gives the means of its distributions, in a tree like its own with None in all other places.
        """


class Known(Module):
    """What a realised model knows of another one: no numbers of its own."""


def is_leaf(node: Any) -> bool:
    """Whether `node` is a distribution or a decision, which realisation replaces by a number."""
    return isinstance(node, AbstractLeaf)


def is_traced(tree: Pytree) -> bool:
    """Whether any number in `tree` is traced by JAX."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def nodes(tree: Pytree) -> list[Any]:
    """All parts of a tree, itself included."""
    found = list[Any]()
    jax.tree.flatten(tree, is_leaf=lambda node: found.append(node) is not None)
    return found


def realised_shape(number: Any) -> tuple[int, ...]:
    """The shape that numbers, a leaf, or a sequence of both have in a realisation."""
    if isinstance(number, list | tuple):
        return (len(number), *(realised_shape(number[0]) if number else ()))
    return number.shape if isinstance(number, AbstractLeaf) else np.shape(number)


def stored_numbers(what: str, value: Any, **place: Any) -> Any:
    """Numbers of a model as they are stored: known ones as a new array, for an integer would be static.

    Leaves and traced numbers stay as they are, and a sequence that holds any becomes a tuple. Raises `ProblemError` for
    anything else, for numbers that are not finite (see `refuse_not_finite`), and for parts that form no array.
    """
    if isinstance(value, AbstractLeaf | Tracer):
        return value
    if isinstance(value, list | tuple) and _is_open(value):
        parts = tuple(stored_numbers(what, part) for part in value)
        shapes = sorted({realised_shape(part) for part in parts})
        if len(shapes) > 1:
            raise ProblemError(f"{what}: expected numbers that form an array; received parts of the shapes {shapes}.")
        return parts
    numbers = real_array(what, value, "numbers, distributions or decisions")
    refuse_not_finite(what, numbers, **place)
    return numbers


def stored_number(what: str, value: Any) -> Any:
    """One number of a model as `stored_numbers` stores it: known, traced, or one leaf. Raises `ProblemError`."""
    number = stored_numbers(what, value)
    if realised_shape(number):
        raise refusal(what, "one number, one distribution or one Decision", value)
    return number


def _is_open(value: Any) -> bool:
    """Whether a value holds a leaf or a traced number, perhaps inside sequences."""
    if isinstance(value, list | tuple):
        return any(map(_is_open, value))
    return isinstance(value, AbstractLeaf | Tracer)


def lowest(number: Any) -> float | None:
    """The smallest value that a number of a model can take, for every realisation and decision; -inf if unbounded.

    For an array or a sequence, the smallest of all entries. None if unknown because numbers are traced.
    """
    return _end(number, lambda leaf: leaf.lowest(), lambda array: np.min(array, initial=np.inf), min)


def highest(number: Any) -> float | None:
    """The largest value that a number of a model can take, as `lowest`."""
    return _end(number, lambda leaf: leaf.highest(), lambda array: np.max(array, initial=-np.inf), max)


def _end(number: Any, of_leaf: Callable[[AbstractLeaf], float | None], of_array: Any, of_ends: Any) -> float | None:
    if isinstance(number, list | tuple):
        ends = (_end(one, of_leaf, of_array, of_ends) for one in number)
        return of_ends((end for end in ends if end is not None), default=None)
    if isinstance(number, AbstractLeaf):
        return of_leaf(number)
    return None if is_traced(number) else float(of_array(np.asarray(number, dtype=float)))


_HIDDEN: dict[type, frozenset[str]] = {}


def transparent(*fields: str) -> Callable[[_Class], _Class]:
    """A class decorator: these container fields are left out of the names of the numbers inside.

    So a mass of `ForwardDynamics(model=arm)` is called `mass`, not `model.mass`. This applies to the decorated class
    only, not to fields of the same name in a user's classes.
    """

    def told(cls: _Class) -> _Class:
        _HIDDEN[cls] = frozenset(fields)
        return cls

    return told


def is_transparent(node: Any, field: str) -> bool:
    """Whether a field of `node` is left out of names."""
    return any(field in _HIDDEN.get(cls, ()) for cls in type(node).__mro__)


def named_leaves(model: Pytree) -> list[tuple[str, Any]]:
    """Every leaf of a model with its name, in the order of `jax.tree.leaves(model, is_leaf=is_leaf)`.

    The name is the one under which the leaf is shared, or its place without transparent fields. If two leaves would
    then have the same name, both have their full places as names.
    """
    paths, _ = tree_flatten_with_path(model, is_leaf=is_leaf)
    short = [_shared_name(leaf) or _text(shown(model, path) or path) for path, leaf in paths]
    counts = Counter(name for name, (_, leaf) in zip(short, paths, strict=True) if not _shared_name(leaf))
    return [
        (name if _shared_name(leaf) or counts[name] == 1 else _text(path), leaf)
        for name, (path, leaf) in zip(short, paths, strict=True)
    ]


def _shared_name(leaf: Any) -> str | None:
    return leaf.shared_name if isinstance(leaf, AbstractLeaf) else None


def _text(path: tuple[Any, ...]) -> str:
    return keystr(path, simple=True, separator=".")


def shown(model: Pytree, path: tuple[Any, ...]) -> tuple[Any, ...]:
    """A path in a model without the keys of transparent fields."""
    kept, node = [], model
    for key in path:
        if not (isinstance(key, GetAttrKey) and is_transparent(node, key.name)):
            kept.append(key)
        node = _child(node, key)
    return tuple(kept)


def _child(node: Any, key: Any) -> Any:
    match key:
        case GetAttrKey(name=name):
            return getattr(node, name, None)
        case DictKey(key=name) | SequenceKey(idx=name):
            return node[name]
    return None  # a container of another library, which has no transparent fields
