"""The outputs of a function of uncertain inputs: an array or a dict of them (any pytree)."""

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError


def part(outputs: Pytree, name: str) -> Pytree:
    """One output of a dict."""
    if not isinstance(outputs, dict):
        raise ProblemError(f"There is one output, without a name; received '{name}'. Drop ['{name}'].")
    if name not in outputs:
        raise ProblemError(f"There is no output '{name}'; expected one of {list(outputs)}.")
    return outputs[name]
