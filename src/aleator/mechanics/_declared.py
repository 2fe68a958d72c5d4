"""What a class of mechanical systems declares: methods that may take the time, and the names of what it has."""

import inspect
from collections.abc import Mapping
from difflib import get_close_matches
from functools import cache
from itertools import product
from typing import Any

from aleator._core.errors import ProblemError

ARGUMENTS: Mapping[str, tuple[str, ...]] = {
    "mass_matrix": ("q",),
    "velocity_map": ("q",),
    "actuation": ("q",),
    "potential_energy": ("q",),
    "bias": ("q", "v"),
    "coriolis": ("q", "v"),
    "forces": ("q", "v"),
    "constraint": ("q",),
    "constraint_jacobian": ("q",),
    "velocity_constraint": ("q", "v"),
    "torque_bounds": ("q", "v"),
    "load": ("q", "v"),
    "body_loads": ("q", "v"),
    "kinetic_energy": ("q", "v"),
    "dissipation": ("q", "v"),
    "accelerations": ("q", "v", "torque"),
    "inverse_dynamics": ("q", "v", "v_dot"),
    "forward_dynamics": ("q", "v", "force"),
    "bodies": (),
    "closures": (),
}
"""The methods that a subclass may write, with their arguments. Each may take the time `t`, in s, after these."""

CONSTRAINTS: Mapping[str, str] = {"constraint_names": "constraint", "velocity_constraint_names": "velocity_constraint"}
"""The names of equations, and the methods that return what is left of these."""

_OPEN = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def call_of(name: str) -> str:
    """A method as it is called without time: `mass_matrix(q)`."""
    return f"{name}({', '.join(ARGUMENTS[name])})"


@cache
def timed_methods(kind: type) -> frozenset[str]:
    """The methods of a class of mechanical systems that take the time.

    Raises `ProblemError` for a method with missing or unknown arguments.
    """
    return frozenset(name for name in ARGUMENTS if hasattr(kind, name) and _names_time(kind, name))


def _names_time(kind: type, name: str) -> bool:
    parameters = list(inspect.signature(getattr(kind, name)).parameters.values())[1:]
    count = len(ARGUMENTS[name])
    plain = [one for one in parameters if one.kind not in _OPEN]
    own, further = plain[:count], plain[count:]
    unknown = [one for one in further if one.name != "t" and one.default is inspect.Parameter.empty]
    too_few = len(own) < count and len(plain) == len(parameters)
    if too_few or unknown or any(one.name == "t" for one in own):
        with_time = ", ".join((*ARGUMENTS[name], "t"))
        raise ProblemError(
            f"{kind.__name__}.{name}: expected {call_of(name)}, or {name}({with_time}) where it depends on time; "
            f"received {name}({', '.join(str(one) for one in parameters)}). Put anything else it needs into fields."
        )
    return any(one.name == "t" for one in further)


def refuse_lost(kind: Any) -> None:
    """Raise `ProblemError` for methods that would do nothing, and for constraints of a base class that would go.

    A method that is called much like one that the class has, with as many arguments, is a slip.
    """
    who, bases = kind.__name__, kind.__mro__[1:]
    for name, value in vars(kind).items():
        is_known = name in ARGUMENTS or any(hasattr(base, name) for base in bases)
        if name.startswith("_") or is_known or not inspect.isfunction(value):
            continue
        count = len(inspect.signature(value).parameters) - 1
        alike = [one for one, given in ARGUMENTS.items() if hasattr(kind, one) and count - len(given) in (0, 1)]
        if close := get_close_matches(name, alike, n=1, cutoff=0.85):
            raise ProblemError(
                f"{who}.{name} has no effect: did you mean {close[0]}? Rename it, even if it is your own."
            )
    for base, (field, method) in product(bases, CONSTRAINTS.items()):
        names, declared = vars(base).get(field, ()), getattr(kind, field)
        known = isinstance(names, tuple | list) and isinstance(declared, tuple | list)
        if lost := [name for name in names if name not in declared] if known else []:
            raise ProblemError(
                f"{who}.{field} leaves out {lost} of {base.__name__}. Name them too, and return their equations as "
                f"well: (*super().{call_of(method)}, ...)."
            )
