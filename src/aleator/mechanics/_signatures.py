"""Which methods of a mechanical system depend on time, read from their signatures once per class."""

import inspect
from collections.abc import Mapping
from functools import cache

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
