"""The base of whatever holds the numbers of a model."""

import equinox as eqx


class Module(eqx.Module):
    """An Equinox module whose methods are plain ones.

    Equinox makes a module of each method at each access, for those who give methods to compiled functions as arguments.
    Nothing here does, and problems are walked through so often that this took much of the time of small solves.
    """

    __getattribute__ = object.__getattribute__

    @property
    def is_declared(self) -> bool:
        """Whether it holds a digest of equations that tells all code in it."""
        return False
