"""What is computed where the library of an FMU is loaded, be it in this process or in one of its own.

Objects there are made by `MAKERS` from what can be sent: names, numbers and arrays. They are made again where a process
has ended.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, final

from aleator.foreign._fmu._evaluations import Field
from aleator.foreign._fmu._inputs import Inputs, Sampled
from aleator.foreign._fmu._opened import Opened
from aleator.foreign._fmu._runs import Runs


def _runs(fmu: Opened, parameters: list[str], outputs: list[str], inputs: Sampled, tolerance: float) -> Runs:
    variables = fmu.variables
    given = Inputs(variables.of_inputs(inputs.names), inputs.times, inputs.values)
    return Runs(fmu, variables.settable(parameters), variables.readable(outputs), given, tolerance)


def _field(fmu: Opened, numbers: Mapping[str, float | None], inputs: list[str], outputs: list[str]) -> Field:
    variables = fmu.variables
    chosen, free, read = variables.settable(numbers), variables.of_inputs(inputs), variables.readable(outputs)
    return Field(fmu, chosen, free, read, list(numbers.values()))


MAKERS: Mapping[str, Callable[..., Any]] = MappingProxyType({"runs": _runs, "field": _field})


class Request(NamedTuple):
    """A call of a method of an object, which has a number and is made by `maker` from `parts` at its first call."""

    number: int
    maker: str
    parts: tuple[Any, ...]
    method: str
    arguments: tuple[Any, ...]


@final
class Objects:
    """The objects of an FMU by their numbers."""

    def __init__(self, fmu: Opened):
        self._fmu = fmu
        self._made: dict[int, Any] = {}

    def answer(self, request: Request) -> Any:
        """What a method of an object returns."""
        if request.number not in self._made:
            self._made[request.number] = MAKERS[request.maker](self._fmu, *request.parts)
        return getattr(self._made[request.number], request.method)(*request.arguments)

    def forget(self, numbers: list[int]) -> None:
        """Give up objects that nobody will ask again."""
        for number in numbers:
            self._made.pop(number, None)
