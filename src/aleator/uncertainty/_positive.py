"""Numbers that physics requires to be positive (masses, stiffnesses): declared in the model, checked before use."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import numpy as np

from aleator._core.arrays import Pytree
from aleator._core.border import refusal
from aleator._core.errors import ProblemError
from aleator._core.leaves import is_leaf, is_transparent, lowest, shown
from aleator.trajectories import AbstractSignal
from aleator.uncertainty._bounded_families import TruncatedNormal
from aleator.uncertainty._distribution import AbstractDistribution
from aleator.uncertainty._families import Normal
from aleator.uncertainty._toleranced import Toleranced

# Standard deviations below the mean beyond which one system in a billion lies.
_FAR = 6


def parameter(unit: str = "", *, positive: bool = False, **options: Any) -> Any:
    """A field of a model with its unit: `m_s: float = al.parameter("kg", positive=True)`.

    With `positive`, a number, decision or distribution in this field that can reach zero is refused.
    """
    if not isinstance(unit, str):
        raise refusal("parameter", "a unit as text, such as 'kg'", unit)
    return eqx.field(metadata={"unit": unit, "positive": positive}, **options)


def fields_of(model: Pytree, path: str = "") -> Iterator[tuple[str, dataclasses.Field, Any]]:
    """The fields of a model and of the modules anywhere inside it: name, field, value."""
    for where, module in jax.tree_util.tree_leaves_with_path(model, is_leaf=_is_module):
        if not _is_module(module) or is_leaf(module):
            continue
        place = path + "".join(f"{jax.tree_util.keystr((key,), simple=True)}." for key in shown(model, where))
        for field in dataclasses.fields(module):
            value = getattr(module, field.name, None)
            yield place + field.name, field, value
            if not field.metadata.get("static", False):
                inside = place if is_transparent(module, field.name) else f"{place}{field.name}."
                yield from fields_of(value, inside)


def _is_module(node: Any) -> bool:
    return isinstance(node, eqx.Module)


def refuse_nonpositive(model: Pytree) -> None:
    """Raise `ProblemError` if a number declared positive can reach zero, for some germ or some decision.

    Values that are not numbers are refused as well, `None` and functions apart.
    """
    for name, field, value in fields_of(model):
        if not field.metadata.get("positive", False):
            continue
        for leaf in jax.tree.leaves(value, is_leaf=_is_whole_part):
            if isinstance(leaf, AbstractSignal) and leaf.unbounded:
                raise ProblemError(_message_of_process(name, leaf))
            # The values of other signals are known only in time: the dynamics check the resulting masses.
            if callable(leaf) and not is_leaf(leaf):
                continue
            least = _lowest(leaf)
            if least is None or not least > 0:
                raise ProblemError(_message(name, leaf, least))


def _is_whole_part(node: Any) -> bool:
    return is_leaf(node) or isinstance(node, AbstractSignal)


def _message_of_process(name: str, signal: Any) -> str:
    return (
        f"'{name}' must stay positive, but a {type(signal).__name__} is Gaussian at every instant, and so unbounded "
        "below. Give a positive function of it, such as al.processes.signal(lambda t, p: 2.0 * jnp.exp(p.noise(t)), "
        "noise=al.processes.RandomProcess(...))."
    )


def _lowest(leaf: Any) -> float | None:
    """The smallest value that a leaf can take; `None` for a leaf that is not a number."""
    numeric = (
        isinstance(leaf, int | float | np.generic | np.ndarray | jax.Array) and np.asarray(leaf).dtype.kind in "biuf"
    )
    return lowest(leaf) if numeric or is_leaf(leaf) else None


def _message(name: str, leaf: Any, least: float | None) -> str:
    if least is None:
        return (
            f"'{name}' must stay positive: expected a number, a distribution or a Decision; "
            f"received {type(leaf).__name__} {leaf!r}. Give a number."
        )
    is_known = isinstance(leaf, AbstractDistribution) and not any(map(is_leaf, leaf.parameters.values()))
    reach = "is unbounded below" if least == -np.inf else f"can reach {least:g}"
    remedy = _replacement(leaf) if is_known else "Raise its lower bound, or those of the decisions in it."
    return f"'{name}' must stay positive, but {leaf} {reach}. {remedy}"


def _replacement(leaf: AbstractDistribution) -> str:
    """What to write for a distribution of known numbers that reaches zero."""
    mean, spread = float(leaf.mean()), float(leaf.std())
    if not mean > 0:
        return "Give a distribution above zero."
    if isinstance(leaf, Normal | TruncatedNormal | Toleranced):
        location, scale = (float(leaf.parameters.get(*one)) for one in (("location", mean), ("scale", spread)))
        if isinstance(leaf, Toleranced):
            lower, upper = map(float, leaf.limits())
            without = "its tolerance zone"
        else:
            lower, upper = location - _FAR * scale, float(leaf.parameters.get("upper", np.inf))
            without = f"{_FAR} standard deviations below"
        end = f", upper={upper:.9g}" if upper < np.inf else ""
        if lower > 0:
            return (
                f"Write TruncatedNormal(location={location:.9g}, scale={scale:.9g}, lower={lower:.9g}{end}), which "
                f"leaves out what is further than {without}."
            )
    return f"Write LogNormal(mean={mean:.9g}, std={spread:.9g}), which has the same mean and standard deviation."
