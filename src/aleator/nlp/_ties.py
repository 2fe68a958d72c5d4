"""Ties: equalities that determine variables, such as the states of a realisation, from the others."""

from typing import NamedTuple

import numpy as np

from aleator._core.errors import ProblemError


class Ties(NamedTuple):
    """Equalities that together determine as many variables from all others.

    - `rows`: of the constraints, shape (ties,); `variables`: those that they determine, shape (ties,). Which row
      belongs to which variable matters little, but a block of rows must determine the block of their variables;
    - `owners`: the realisation to which each belongs, -1 for none, shape (ties,): for messages alone.
    """

    rows: np.ndarray
    variables: np.ndarray
    owners: np.ndarray

    def kept(self, rows: np.ndarray, variables: np.ndarray) -> "Ties":
        """Those that are left where only some rows and variables are, in the numbers that these have then.

        - `rows`, `variables`: truth values, shapes (m,) and (n,).
        """
        kept = rows[self.rows] & variables[self.variables]
        numbers, others = np.cumsum(rows) - 1, np.cumsum(variables) - 1
        return Ties(numbers[self.rows[kept]], others[self.variables[kept]], self.owners[kept])


def check_ties(ties: Ties, is_equality: np.ndarray, variables: int) -> None:
    """Refuse ties of rows that are no equalities, and rows or variables that are tied twice or do not exist."""
    counts = {"rows": is_equality.size, "variables": variables, "owners": np.iinfo(np.int64).max}
    for (name, count), numbers in zip(counts.items(), ties, strict=True):
        is_whole = isinstance(numbers, np.ndarray) and numbers.dtype.kind == "i" and numbers.shape == ties.rows.shape
        least = -1 if name == "owners" else 0
        if not is_whole or numbers.ndim != 1 or np.any((numbers < least) | (numbers >= count)):
            raise ProblemError(
                f"Expected `ties.{name}` as whole numbers, {len(ties.rows)} from {least} to {count - 1}. "
                f"Received {numbers}."
            )
        if name != "owners" and np.bincount(numbers, minlength=1).max() > 1:
            raise ProblemError(f"Expected every number of `ties.{name}` once. Received some twice.")
    if not is_equality[ties.rows].all():
        first = int(ties.rows[~is_equality[ties.rows]][0])
        raise ProblemError(f"Expected equalities as `ties.rows`. Received row {first}, whose bounds differ.")
