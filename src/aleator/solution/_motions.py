"""`Motions`: quantities over time of some realisations of a design, with their means and spreads, by name."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, final

import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.border import refusal, writing
from aleator.solution._certificate import Moments, ends

if TYPE_CHECKING:
    import xarray


@final
@dataclass(frozen=True, eq=False, repr=False)
class Motions(Mapping[str, "xarray.Dataset"]):
    """Inputs, states or outputs over time, by name: `solution.outputs["x"]` is an `xarray.Dataset` with units.

    Its variables are `mean` and `std` along `time` (s), and `systems`, the quantity in each system that was simulated,
    along `system` and `time`. The uncertain numbers of each system are coordinates along `system`, by name. A vector
    has further dimensions; what has no time has no `time`.

    - `kind`: `inputs`, `states` or `outputs`; `times`: the instants, s, None without time;
    - `systems`: by name, shape (systems, instants, ...); `moments`: mean and standard deviation of each, without the
      axis of systems;
    - `numbers`: the uncertain numbers of each system, by name; `units`: by name, as far as known;
    - `where`: which of the times are those of a name, in whose phase alone it is known; all by default.
    """

    kind: str
    times: Float[np.ndarray, " instants"] | None
    systems: Mapping[str, Float[np.ndarray, "systems ..."]]
    moments: Mapping[str, Moments]
    numbers: Mapping[str, Float[np.ndarray | Array, " systems"]]
    units: Mapping[str, str]
    where: Callable[[str], slice] | None = None

    def times_of(self, name: str) -> Float[np.ndarray, " instants"] | None:
        """The instants at which something is known, s; None without time."""
        return None if self.times is None else self.times[self._of(name)]

    def _of(self, name: str) -> slice:
        return slice(None) if self.where is None else self.where(name)

    @override
    def __getitem__(self, name: str) -> "xarray.Dataset":
        import xarray

        if name not in self.systems:
            raise refusal(self.kind, f"one of {list(self.systems)}", name)
        values, moments, unit = self.systems[name], self.moments[name], {"units": self.units.get(name, "")}
        times = self.times_of(name)
        time = {} if times is None else {"time": ("time", times, {"units": "s"})}
        along = (*time, *(f"component {i}" for i in range(values.ndim - 1 - len(time))))
        return xarray.Dataset(
            {
                "mean": (along, moments.mean, {"long_name": f"mean of {name}", **unit}),
                "std": (along, moments.std, {"long_name": f"standard deviation of {name}", **unit}),
                "systems": (("system", *along), values, {"long_name": name, **unit}),
            },
            coords=time | {number: ("system", each) for number, each in self.numbers.items()},
        )

    @override
    def __iter__(self) -> Iterator[str]:
        return iter(self.systems)

    @override
    def __len__(self) -> int:
        return len(self.systems)

    @override
    def __contains__(self, name: object) -> bool:
        return name in self.systems

    def to_netcdf(self, path: str | Path) -> None:
        """Write all of them to one netCDF file: each in a group of its own name.

        Raises `ProblemError` if the file cannot be written.
        """
        with writing("to_netcdf", path) as file:
            for i, (name, dataset) in enumerate(self.items()):
                dataset.to_netcdf(file, mode="a" if i else "w", group=name.replace("/", "_"), engine="h5netcdf")

    def to_csv(self, path: str | Path) -> None:
        """Write means and standard deviations as a table: a row for each instant, columns such as `force mean (N)`.

        Raises `ProblemError` if the file cannot be written.
        """
        import pandas

        columns = {}
        for name, dataset in self.items():
            unit, times = self.units.get(name), dataset.get("time")
            for kind in ("mean", "std"):
                values = dataset[kind].values
                table = values.reshape(1 if times is None else len(times), -1).T
                for i, column in enumerate(table):
                    place, of = f"[{i}]" if len(table) > 1 else "", f" ({unit})" if unit else ""
                    columns[f"{name}{place} {kind}{of}"] = pandas.Series(column, index=times)
        with writing("to_csv", path) as file:
            pandas.DataFrame(columns).to_csv(file, index=self.times is not None, index_label="time (s)")

    @override
    def __repr__(self) -> str:
        instants = "" if self.times is None else f", {len(self.times)} instants"
        return f"<Motions of {len(self._any)} systems{instants}: {', '.join(self)}>"

    @override
    def __str__(self) -> str:
        span = "" if self.times is None else f" from t = {self.times[0]:.4g} to {self.times[-1]:.4g} s"
        ranges = ", ".join(f"{name} {ends(values)}" for name, values in self.systems.items()) or "nothing"
        return f"{len(self._any)} systems{span}: {ranges}"

    @property
    def _any(self) -> np.ndarray:
        return next(iter(self.systems.values()), np.zeros(0))
