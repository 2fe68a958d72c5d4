"""`ask`: the points of an expansion, to be answered by whoever has the model."""

import csv
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np
from jaxtyping import Float
from typing_extensions import override

from aleator._core import border
from aleator._core.arrays import Pytree, jax_array
from aleator._core.errors import ProblemError, SimulationError
from aleator.analysis import Expanded, expand
from aleator.ensemble import AbstractBox, Realisation, inputs_at, listed
from aleator.expansion import Expansion, candidate_terms
from aleator.foreign._failures import drop_given, most_of, sound, warn_of_dropped
from aleator.foreign._responses import NUMBER, answers, columns_of
from aleator.uncertainty import placements

if TYPE_CHECKING:
    import xarray


def ask(model: Pytree, expansion: Expansion | None = None) -> "Asked":
    """The points at which `al.expand` would call a function: `al.foreign.ask({"w": al.Normal(1.0, 0.1)})`.

    - `model`: a dict of distributions or any other pytree with distributions in it. Decisions are held at their
      initial values;
    - `expansion`: settings with a fixed index set, default `al.Expansion()`.

    Asked again, in another process too, it gives the same points. Raises `ProblemError` if nothing is uncertain, or if
    points depend on outputs, as they do for adaptive index sets and for `al.MultiElement()`.
    """
    if not isinstance(expansion, Expansion | None):
        raise border.refusal("ask: the expansion", "an Expansion, such as al.Expansion(order=4)", expansion)
    places = placements(model)
    if not places.distributions:
        raise border.refusal("ask: the model", "distributions in it, such as al.Uniform.bounds(0.9, 1.1)", model)
    if NUMBER in places.distributions:
        raise ProblemError(f"ask: {NUMBER!r} is the name of the samples' numbers; expected another name of the input.")
    expansion = expansion or Expansion()
    _, nodes = candidate_terms(places.germs, expansion)
    decisions = jax_array(places.vector("initial"))
    rows = [inputs_at(places, point, decisions) for point in nodes.points]
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

        points = {name: (NUMBER, values) for name, values in self.points.items()}
        return xarray.Dataset(coords=points | {NUMBER: np.arange(1, len(self) + 1)})

    def write_csv(self, path: str | os.PathLike) -> None:
        """Write the points as a CSV file with one line for each sample, all digits of each number.

        Raises `ProblemError` if the file cannot be written.
        """
        rows = zip(*(values.tolist() for values in self.points.values()), strict=True)
        try:
            with Path(path).open("w", encoding="utf-8", newline="") as file:
                table = csv.writer(file, lineterminator="\n")
                table.writerow([NUMBER, *self.points])
                table.writerows([number, *row] for number, row in enumerate(rows, 1))
        except TypeError as error:
            raise border.refusal("write_csv", "the path of a file", path) from error
        except OSError as error:
            raise ProblemError(f"write_csv: {path} cannot be written ({error.strerror}).") from error

    def tell(self, responses: Any, *, drop: float = 0.0, times: Any = None) -> Expanded:
        """The expansion of the responses: the same as that of `al.expand`, to the last bit.

        - `responses`: the path of the CSV file with further columns for outputs, `y` or `y[0]`, `y[1]`, ...; or an
          `xarray.Dataset` with dimension `sample`; or a dict of arrays of shape (n, *shape), or one such array. Rows
          that give the number of their `sample` may come in any order; values of the inputs, which a file and a dataset
          must have, are compared with the points, to six digits at least. A column `comment` may have texts, which are
          left aside. A response is missing if its row is, or if all its numbers are NaN
          or empty;
        - `drop`: the largest part of the samples that may be missing, below one half; least squares then takes the
          others, as long as it stays well conditioned;
        - `times`: as in `al.expand`.

        Raises `ProblemError` if points were changed or cannot be told apart, `SimulationError` if more samples than
        `drop` allows are missing or not finite. Warns with `SimulationWarning` of a bias if some are.
        """
        part = drop_given("tell: drop", drop)
        rows = answers(self.points, columns_of(responses, list(self.points)))
        return expand(_Told(rows, part), self._model, self._expansion, times=times)

    def __str__(self) -> str:
        lines = [f"{len(self)} samples of {', '.join(self.points)}"]
        for name, values in self.points.items():
            lines.append(f"  {name}: {values.min():.6g} to {values.max():.6g}")
        return "\n".join([*lines, "tell(responses) expands the outputs"])


@final
class _Told(AbstractBox):
    """A box that knows its outputs at the points that were asked for, and no others."""

    def __init__(self, rows: Sequence[Pytree | None], drop: float):
        self._rows, self._drop = rows, drop
        self.__name__ = "the model"

    @override
    def __call__(self, realised: Mapping[str, Any]) -> Pytree:
        raise ProblemError(f"tell: there is no response at {listed(realised)}, for which nobody was asked.")

    @override
    def at_all(self, realisations: Sequence[Realisation], *, whole: bool) -> list[Pytree | None]:
        found: list[Pytree | None] = []
        failures: dict[int, str] = {}
        for index, outputs in enumerate(self._rows):
            reason = "it has no response" if outputs is None else _unsound(outputs)
            if reason:
                failures[index] = reason
            found.append(None if reason else outputs)
        most = 0 if whole else most_of(self._drop, len(found))
        if len(failures) > most:
            first = min(failures)
            raise SimulationError(
                f"tell: {len(failures)} of {len(found)} samples have no response of finite numbers, and drop="
                f"{self._drop:g} allows {most}{' here' * whole}: first {realisations[first]}, {failures[first]}."
            )
        if failures:
            warn_of_dropped("the model", realisations, failures)
        return found


def _unsound(outputs: Pytree) -> str:
    try:
        sound(outputs, "the model", None)
    except SimulationError as error:
        return str(error)
    return ""
