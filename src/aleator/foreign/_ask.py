"""`ask`: the points of an expansion, to be answered by whoever has the model; the responses that come back."""

import os
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, final

import numpy as np
from jaxtyping import Float, Int
from typing_extensions import override

from aleator._core import border
from aleator._core.arrays import Pytree, jax_array
from aleator._core.errors import ProblemError, SimulationError
from aleator._core.leaves import in_order
from aleator.analysis import Expanded, expand, fresh_points
from aleator.ensemble import AbstractBox, Realisation, inputs_at, listed
from aleator.expansion import Expansion, candidate_terms
from aleator.foreign._black_box import Samples, drop_given
from aleator.trajectories import numbers_in, read_table
from aleator.uncertainty import placements, refuse_intervals, refuse_nonpositive

if TYPE_CHECKING:
    import xarray

# The column with the numbers of samples, from 1 on, and those that nobody reads here, which may have texts.
_NUMBER, _COMMENTS = "sample", ("comment", "comments")
# Inputs may be rounded to six digits: by this part of the number, and no more than this part of the range; and by this
# part of the largest number, as spreadsheets round (15 digits).
_SIX_DIGITS, _OF_RANGE, _ROUNDED = 5.000001e-6, 1e-3, 1e-9
# A column with one entry of an output: y[3].
_ENTRY = re.compile(r"(.+)\[(\d+)\]")


def ask(model: Pytree, expansion: Expansion | None = None) -> "Asked":
    """The points at which `al.expand` would call a function: `al.foreign.ask({"w": al.Normal(1.0, 0.1)})`.

    - `model`: a dict of distributions or any other pytree with distributions in it. Decisions are held at their
      initial values;
    - `expansion`: settings with a fixed index set, default `al.Expansion()`.

    Asked again, in another process too, it gives the same points. Raises `ProblemError` if nothing is uncertain, or if
    points depend on outputs, as they do for adaptive index sets and for `al.MultiElement()`.
    """
    expansion = border.one_of("ask: the expansion", expansion or Expansion(), Expansion, "al.Expansion(order=4)")
    model = in_order(model)
    refuse_nonpositive(model)
    places = placements(model)
    refuse_intervals("ask", places)
    if not places.distributions or _NUMBER in places.distributions:
        expected = f"distributions in it, such as al.Uniform.bounds(0.9, 1.1), none of the name {_NUMBER!r}"
        raise border.refusal("ask: the model", expected, model)
    _, nodes = candidate_terms(places.germs, expansion)
    decisions = jax_array(places.vector("initial"))
    every = np.concatenate([nodes.points, fresh_points(places.germs, len(nodes.points), traced=False)])
    rows = [inputs_at(places, point, decisions) for point in every]
    points = {name: np.array([row[name] for row in rows]) for name in places.distributions}
    for values in points.values():
        values.setflags(write=False)
    return Asked(model, expansion, points)


@final
class Asked:
    """The points of an expansion as a table, and what becomes of the answers.

    - `points`: the values of each uncertain input by name, shape (n,), in their own units; samples are counted from 1;
    - `dataset`: the same as an `xarray.Dataset` with a coordinate `sample`;
    - `write_csv(path)`: the same as a file, with a column `sample`, to which columns of outputs are added;
    - `tell(responses)`: the expansion of the outputs.
    """

    def __init__(self, model: Pytree, expansion: Expansion, points: dict[str, Float[np.ndarray, " n"]]):
        self._model, self._expansion, self.points = model, expansion, points

    def __len__(self) -> int:
        return len(next(iter(self.points.values())))

    @property
    def dataset(self) -> "xarray.Dataset":
        """The points with dimension `sample`; outputs may be added to it."""
        import xarray

        points = {name: (_NUMBER, values) for name, values in self.points.items()}
        return xarray.Dataset(coords=points | {_NUMBER: np.arange(1, len(self) + 1)})

    def write_csv(self, path: str | os.PathLike) -> None:
        """Write the points as a CSV file with one line for each sample, all digits of each number.

        Raises `ProblemError` if the file cannot be written.
        """
        with border.writing("write_csv", path) as place:
            self.dataset.to_dataframe().to_csv(place, columns=list(self.points), lineterminator="\n")

    def tell(self, responses: Any, *, drop: float = 0.0, times: Any = None) -> Expanded:
        """The expansion of the responses: the same as that of `al.expand`, to the last bit.

        - `responses`: the path of the CSV file with further columns for outputs, `y` or `y[0]`, `y[1]`, ...; or an
          `xarray.Dataset` with dimension `sample`; or a dict of arrays of shape (n, *shape). Rows
          that give the number of their `sample` may come in any order; values of the inputs, which a file and a dataset
          must have, are compared with the points, to six digits at least. A column `comment` may have texts. A response
          is missing if its row is, or if all its numbers are NaN or empty;
        - `drop`: the largest part of the samples that may be missing, below one half; least squares then takes the
          others, as long as it stays well conditioned;
        - `times`: as in `al.expand`.

        Raises `ProblemError` if points were changed, `SimulationError` if more samples than `drop` allows are missing
        or not finite. Warns with `SimulationWarning` of a bias if some are.
        """
        part = drop_given("tell: drop", drop)
        box = _Responses(_answers(self.points, responses), part)
        return expand(box, self._model, self._expansion, times=times)

    def __str__(self) -> str:
        ranges = [f"  {name}: {values.min():.6g} to {values.max():.6g}" for name, values in self.points.items()]
        head = f"{len(self)} samples of {', '.join(self.points)}"
        return "\n".join([head, *ranges, "tell(responses) expands the outputs"])


@final
class _Responses(AbstractBox):
    """A box that knows its outputs at the points that were asked for, and no others."""

    def __init__(self, rows: Sequence[Pytree | None], drop: float):
        self._rows, self._drop = rows, drop
        self.__name__ = "the model"

    @override
    def __call__(self, realised: Mapping[str, Any]) -> Pytree:
        raise ProblemError(f"tell: there is no response at {listed(realised)}, for which nobody was asked.")

    @override
    def at_all(self, realisations: Sequence[Realisation], *, whole: bool) -> list[Pytree | None]:
        samples = Samples(f"'{self.__name__}'", realisations, self._drop, whole=whole)
        found: list[Pytree | None] = [None] * len(realisations)
        for index, realisation in enumerate(realisations):
            try:
                if (row := self._rows[realisation.number - 1]) is None:
                    raise SimulationError("it has no response")
                found[index] = samples.sound(index, row)
            except SimulationError as error:
                samples.fail(index, error)
        samples.warn_of_dropped()
        return found


# --- Responses in any form --------------------------------------------------------------------------------------------


def _answers(points: Mapping[str, Float[np.ndarray, " n"]], responses: Any) -> list[Pytree | None]:
    """The response of each sample that was asked for; None where it is missing.

    Raises `ProblemError` if rows do not belong to the points.
    """
    given: Any = responses
    if isinstance(responses, str | os.PathLike):
        given = _from_table(responses)
    elif hasattr(given, "data_vars"):  # an `xarray.Dataset`, whose library takes long to import
        own = {str(name): values for name, values in given.variables.items() if _NUMBER in values.dims}
        given = {name: values.transpose(_NUMBER, ...).values for name, values in own.items()}
    columns = dict[str, np.ndarray]()
    for name, rows in border.one_of("tell: responses", given, Mapping, "{'y': array}, or a table").items():
        expected = "real numbers with a row for each sample"
        array = border.real_array(f"tell: {border.a_name('tell: an output', name)}", rows, expected)
        columns[name] = np.atleast_1d(array)
    if missing := [name for name in (_NUMBER, *points) if given is not responses and name not in columns]:
        raise ProblemError(
            f"tell: expected the points that were asked for beside the outputs, to compare them; {missing} are missing "
            f"among {list(columns)}."
        )
    count = len(next(iter(points.values())))
    lengths = {len(rows) for rows in columns.values()}
    if len(lengths) > 1 or (_NUMBER not in columns and lengths != {count}):
        expected = f"tell: expected {count} rows, or a column {_NUMBER!r} with their numbers"
        raise ProblemError(f"{expected}; received {' and '.join(map(str, sorted(lengths)))} rows.")
    numbers = _numbers(columns[_NUMBER], count) if _NUMBER in columns else np.arange(count)
    for name, asked in points.items():
        if name in columns:
            _refuse_changed(name, asked, columns[name], numbers)
    outputs = {name: values for name, values in columns.items() if name not in (_NUMBER, *points)}
    found: list[Pytree | None] = [None] * count
    for row, number in enumerate(numbers.tolist()):
        response = {name: np.array(values[row]) for name, values in outputs.items()}
        if not all(np.isnan(value).all() for value in response.values()):
            found[number] = response
    return found


def _numbers(values: np.ndarray, count: int) -> Int[np.ndarray, " rows"]:
    """The samples of rows as indices from 0 on."""
    seen, times = np.unique(values, return_counts=True)
    if (bad := seen[(times > 1) | ~np.isin(seen, np.arange(1, count + 1))]).size:
        raise border.refusal(f"tell: {_NUMBER!r}", f"the numbers of samples from 1 to {count}, each once", bad.tolist())
    return values.astype(int) - 1


def _refuse_changed(name: str, points: np.ndarray, received: np.ndarray, numbers: Int[np.ndarray, " rows"]) -> None:
    """Refuse an input that differs from the one that was asked for."""
    asked, span, largest = points[numbers], np.ptp(points), np.abs(points).max()
    allowed = np.maximum(np.minimum(_SIX_DIGITS * np.abs(asked), _OF_RANGE * span), _ROUNDED * max(span, largest))
    if len(wrong := np.flatnonzero(~(np.abs(received - asked) <= allowed))):
        raise ProblemError(
            f"tell: expected {name} = {float(asked[wrong[0]])!r} at sample {numbers[wrong[0]] + 1}, as asked; "
            f"received {float(received[wrong[0]])!r} ({len(wrong)} of {len(asked)} rows differ). Were points "
            "changed or rows reordered? Ask again, or answer the points that were asked."
        )


def _from_table(path: Any) -> dict[str, np.ndarray]:
    names, rows = read_table("tell", path)
    columns = defaultdict[str, list[tuple[int | None, Any]]](list)
    for column, name in enumerate(map(str.strip, names)):
        if name.lower() in _COMMENTS:
            continue
        try:
            values = numbers_in(rows, column)
        except ValueError as error:
            raise ProblemError(
                f"{path}: expected numbers in the column {name!r}, empty where there is no response; {error}. "
                f"Texts may stand in a column {_COMMENTS[0]!r}."
            ) from error
        part = _ENTRY.fullmatch(name)
        own, place = (name, None) if part is None else (part[1], int(part[2]))
        columns[own].append((place, values))
    found: dict[str, np.ndarray] = {}
    for name, entries in columns.items():
        places, values = zip(*entries, strict=True)
        if places not in ((None,), (*range(len(entries)),)):
            raise ProblemError(f"{path}: expected one column {name!r}, or its entries {name}[0], {name}[1], ..., once.")
        found[name] = values[0] if places == (None,) else np.stack(values, axis=1)
    return found
