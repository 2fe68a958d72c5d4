"""Blocks evaluated tile by tile, on all cores: one compiled function serves every mesh.

A family over realisations and mesh points is cut into tiles of one size; where it ends within a tile, its last blocks
are repeated. So what is compiled does not depend on the number of mesh points, nor, beyond a few, on that of
realisations, and results do not depend on the number of cores.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple, TypeAlias, final

import numpy as np
from jaxtyping import Array, Float, Int

from aleator._core.compilation import Bound, Compiled, Use
from aleator._core.parallel import in_order
from aleator.design import Problem
from aleator.dynamics import AbstractMeanRate
from aleator.statistics import Constants
from aleator.transcription.simultaneous._assembly import Pattern
from aleator.transcription.simultaneous._blocks import Family
from aleator.transcription.simultaneous._families import functions
from aleator.transcription.simultaneous._layout import Plan
from aleator.transcription.simultaneous._shapes import apart

# Blocks of a tile, the least and the most, and the most along the first axis, where their number is a multiple of the
# last: enough for a call to take longer than its preparation, and few enough for both cores and their caches.
_LEAST, _MOST, _MOST_OUTER, _STEP = 64, 4096, 32, 8


class Form(NamedTuple):
    """The shapes of what some blocks of a family are given: shared and own variables, and data of each index, if any.

    - `family`: its number; `rows`: the shape of their rows;
    - `slopes`, `bends`: which of a block's derivatives are asked for, as bytes of their numbers: see `Pattern`.
    """

    family: int
    shared: tuple[int, ...]
    own: tuple[int, ...]
    outer: tuple[int, ...] | None
    inner: tuple[int, ...] | None
    rows: tuple[int, ...]
    slopes: bytes
    bends: bytes


Source: TypeAlias = tuple[Problem, Constants | None, Plan | AbstractMeanRate, tuple[Form, ...]]
"""What some blocks follow from, beside numbers: see `functions`; their forms."""


def _families(source: Source, numbers: Array) -> list[Family]:
    """Blocks with what they are given: the variables of all, then the data of all, side by side."""
    problem, constants, plan, forms = source
    every = functions(problem, constants, plan)
    shapes = [*(form[1:3] for form in forms), *(form[3:5] for form in forms)]
    parts = iter(apart(numbers, [shape for some in shapes for shape in some if shape]))
    variables = [(next(parts), next(parts)) for _ in forms]
    data = [[next(parts) if shape else () for shape in form[3:5]] for form in forms]
    return [Family(every[form.family], *own, *both) for form, own, both in zip(forms, variables, data, strict=True)]


def _evaluate(
    source: Source, numbers: Float[Array, " n"]
) -> list[tuple[Float[Array, "outer inner rows"], Float[Array, "outer inner slopes"]]]:
    entries = [np.frombuffer(form.slopes, dtype=int) for form in source[-1]]
    return [one.differentiated(some) for one, some in zip(_families(source, numbers), entries, strict=True)]


def _curve(
    source: Source, at: tuple[Float[Array, " n"], Float[Array, " rows"]]
) -> list[Float[Array, "outer inner bends"]]:
    numbers, weights = at
    each = apart(weights, [form.rows for form in source[-1]])
    entries = [np.frombuffer(form.bends, dtype=int) for form in source[-1]]
    parts = zip(_families(source, numbers), each, entries, strict=True)
    return [one.curved(weighted, some) for one, weighted, some in parts]


EVALUATE = Compiled(_evaluate, use=Use.ROWS)
CURVE = Compiled(_curve, use=Use.ROWS)


@final
@dataclass(frozen=True)
class Tile:
    """Some blocks of a family.

    - `place`: where they are in it;
    - `variables`: the numbers of their shared variables, then of their own; `data`: of both indices;
    - `rows`: the numbers of their rows.
    """

    form: Form
    place: tuple[slice, slice]
    variables: Int[np.ndarray, " variables"]
    data: Float[np.ndarray, " data"]
    rows: Int[np.ndarray, " rows"]

    def write(self, results: np.ndarray, into: np.ndarray) -> None:
        """Results of the blocks among those of their family."""
        target = into[self.place]
        target[...] = results[: target.shape[0], : target.shape[1]]


def tiles_of(number: int, family: Family, pattern: Pattern, size: tuple[int, ...]) -> list[Tile]:
    """A family, which holds the numbers of its variables, in tiles of a size."""
    shared, own = family.shared, family.own
    data = [None if isinstance(one, tuple) else np.asarray(one) for one in (family.outer, family.inner)]
    outer, inner = own.shape[:2]
    height, width = size
    tiles = []
    for i, j in product(range(0, outer, height), range(0, inner, width)):
        # Beyond the last block it is repeated.
        which = np.minimum(np.arange(i, i + height), outer - 1), np.minimum(np.arange(j, j + width), inner - 1)
        at = np.ix_(*which)
        of_outer, of_inner = (None if one is None else one[some] for one, some in zip(data, which, strict=True))
        tiles.append(
            Tile(
                Form(
                    number,
                    shared.shape,
                    own[at].shape,
                    _shape(of_outer),
                    _shape(of_inner),
                    pattern.rows[at].shape,
                    pattern.slopes.tobytes(),
                    pattern.bends.tobytes(),
                ),
                (slice(i, min(i + height, outer)), slice(j, min(j + width, inner))),
                np.concatenate([shared, own[at].ravel()]),
                np.concatenate([np.zeros(0), *(one.ravel() for one in (of_outer, of_inner) if one is not None)]),
                pattern.rows[at].ravel(),
            )
        )
    return tiles


def _shape(data: np.ndarray | None) -> tuple[int, ...] | None:
    return None if data is None else data.shape


def tile_size(outer: int, inner: int) -> tuple[int, int]:
    """The size of tiles for a family with so many blocks on its first mesh."""
    parts = -(-outer // _MOST_OUTER)
    height = outer if parts == 1 else _STEP * -(-outer // (parts * _STEP))
    width = -(-inner // -(-inner * height // _MOST))
    return height, max(width, _LEAST // height)


@final
class Call:
    """Tiles that are evaluated together: what they are given is gathered in one array, since each costs time."""

    def __init__(self, tiles: tuple[Tile, ...], evaluate: Bound, curve: Bound):
        self.tiles, self.evaluate, self.curve = tiles, evaluate, curve
        self._variables = np.concatenate([one.variables for one in tiles])
        self._data = np.concatenate([one.data for one in tiles])
        self._rows = np.concatenate([one.rows for one in tiles])

    def at(
        self, variables: Float[np.ndarray, " n"], weights: Float[np.ndarray, " rows"] | None
    ) -> tuple[Bound, Float[np.ndarray, " numbers"] | tuple[np.ndarray, np.ndarray]]:
        """The compiled function and its argument: of values and first derivatives, or second ones of weighted rows."""
        numbers = np.concatenate([variables[self._variables], self._data])
        return (self.evaluate, numbers) if weights is None else (self.curve, (numbers, weights[self._rows]))


def calls_of(
    problem: Problem, constants: Constants | None, plan: Plan | AbstractMeanRate, together: list[tuple[Tile, ...]]
) -> list[Call]:
    """The calls for tiles of the same forms."""
    source = problem, constants, plan, tuple(one.form for one in together[0])
    functions = [one.bound(source) for one in (EVALUATE, CURVE)]
    return [Call(tiles, *functions) for tiles in together]


def results(
    calls: list[Call], variables: Float[np.ndarray, " n"], weights: Float[np.ndarray, " rows"] | None = None
) -> Iterator[tuple[Tile, Any]]:
    """Each tile and its results: see `Call.at`."""
    # The calling thread traces a user's code before other threads start.
    for function, argument in (call.at(variables, weights) for call in _one_of_each(calls)):
        function.prepare(argument)

    def evaluated(call: Call) -> Any:
        function, argument = call.at(variables, weights)
        return function(argument)

    for call, values in zip(calls, in_order(evaluated, calls), strict=True):
        yield from zip(call.tiles, values, strict=True)


def begin(calls: list[Call], variables: Float[np.ndarray, " n"], weights: Float[np.ndarray, " rows"]) -> None:
    """Begin to compile what some second derivatives need, on other cores."""
    for function, argument in (call.at(variables, weights) for call in _one_of_each(calls)):
        function.begin(argument)


def _one_of_each(calls: list[Call]) -> list[Call]:
    """A call for each compiled function."""
    return list({call.evaluate: call for call in reversed(calls)}.values())
