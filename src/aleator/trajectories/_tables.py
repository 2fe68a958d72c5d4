"""Tables in CSV files."""

import csv
from typing import Any

import numpy as np
from jaxtyping import Float

from aleator._core.errors import ProblemError
from aleator._core.files import content_of

_SEPARATORS = {";": "semicolons", "\t": "tabs"}


def read_table(what: str, path: Any) -> tuple[list[str], list[list[str]]]:
    """The names of the columns of a CSV file, and its rows; lines that start with `#` are comments.

    Raises `ProblemError` if there is no such file or if it is no table; `what` begins the sentence for a wrong path.
    """
    try:
        text = content_of(path).decode("utf-8-sig")
        names, *rows = csv.reader(line for line in text.splitlines() if line.strip() and not line.startswith("#"))
    except TypeError as error:
        raise ProblemError(f"{what}: expected the path of a file; received {path!r}.") from error
    except UnicodeDecodeError as error:
        byte = f"{error.object[error.start]:#x}"
        raise ProblemError(f"{path}: expected text in UTF-8; received the byte {byte}.") from error
    except (OSError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise ProblemError(f"{path}: expected a CSV file that can be read; received: {reason}.") from error
    except ValueError as error:
        raise ProblemError(f"{path}: expected a line with names of columns; received an empty file.") from error
    if separator := next((word for mark, word in _SEPARATORS.items() if mark in "".join(names[:1])), ""):
        raise ProblemError(f"{path}: expected commas between columns, and decimal points; received {separator}.")
    for number, row in enumerate(rows, 1):
        if any(one.strip() for one in row[len(names) :]):
            raise ProblemError(
                f"{path}: expected {len(names)} entries in each row, as in the line of names; received {len(row)} in "
                f"row {number}. Numbers have decimal points."
            )
    return names, rows


def numbers_in(rows: list[list[str]], column: int) -> Float[np.ndarray, " rows"]:
    """The numbers in a column of a table. Raises `ValueError`, naming the row, for anything else."""
    numbers = []
    for number, row in enumerate(rows, 1):
        try:
            numbers.append(entry(row, column))
        except ValueError as error:
            raise ValueError(f"row {number}: {error}") from None
    return np.array(numbers)


def entry(row: list[str], column: int) -> float:
    """A number in a row of a table; NaN where the column is missing or empty."""
    text = (row[column] if column < len(row) else "").strip() or "nan"
    if "_" in text:  # which Python takes for a separator of digits
        raise ValueError(f"could not convert string to float: {text!r}")
    return float(text)
