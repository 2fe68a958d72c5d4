"""Dimensions as drawings give them: a nominal value, its limits, and the capability of the process that makes it."""

import itertools
import re
from typing import Any, ClassVar, Literal, NamedTuple, final

import equinox as eqx
import numpy as np
from typing_extensions import override

from aleator._core.arrays import Scalar
from aleator._core.border import refusal
from aleator._core.errors import ProblemError
from aleator._core.leaves import AbstractLeaf
from aleator.uncertainty._distribution import Canonical, Form
from aleator.uncertainty._families import NORMAL, AbstractFamily, Standard


class _Zone(NamedTuple):
    """A tolerance zone: its nominal value and the distances of its two limits from it."""

    nominal: Scalar
    plus: Scalar
    minus: Scalar

    @property
    def middle(self) -> Scalar:
        return self.nominal + (self.plus - self.minus) / 2

    @property
    def half_width(self) -> Scalar:
        return (self.plus + self.minus) / 2


_ZONES = (("nominal", "tolerance"), ("nominal", "plus", "minus"))
_CAPABILITIES = (("cp",), ("sigmas",), ("cp", "cpk"))


def _zone(parameters: dict[str, Any]) -> _Zone:
    if "tolerance" in parameters:
        return _Zone(parameters["nominal"], parameters["tolerance"], parameters["tolerance"])
    return _Zone(parameters["nominal"], parameters["plus"], parameters["minus"])


def _canonical(**parameters: Any) -> Canonical:
    """Canonical form of the normal distribution, with the mean shifted upwards where `cpk < cp`."""
    cp = parameters["sigmas"] / 3 if "sigmas" in parameters else parameters["cp"]
    zone, shift = _zone(parameters), 1 - parameters.get("cpk", cp) / cp
    return Canonical(zone.middle + shift * zone.half_width, zone.half_width / (3 * cp))


@final
class Toleranced(AbstractFamily):
    """A normal distribution in a tolerance zone: `Toleranced(27.645, plus=0.05, minus=0.02, cp=1.33)`.

    The zone extends from `nominal - minus` to `nominal + plus`; give `tolerance` where both are equal. Its width is `6
    cp` standard deviations, or `2 sigmas` of them (default `cp=1`, that is `sigmas=3`). The mean lies in the middle of
    the zone. For a process that is off centre give `cpk < cp`: the mean is then shifted by `(1 - cpk / cp)` half-widths
    towards the limit named by `towards` (default "upper").

    The distribution is not truncated to the zone. `limits()` gives the zone, which worst cases use.
    """

    towards: Literal["upper", "lower"] = eqx.field(static=True)

    STANDARD: ClassVar[Standard] = NORMAL
    FORMS: ClassVar[dict[tuple[str, ...], Form]] = {
        zone + capability: Form(_canonical) for zone, capability in itertools.product(_ZONES, _CAPABILITIES)
    }
    REQUIRES: ClassVar[str] = (
        "finite numbers, limits in order (plus + minus or tolerance above 0), cp or sigmas above 0, and cpk at most cp"
    )

    def __init__(
        self,
        nominal: Any = None,
        *,
        tolerance: Any = None,
        plus: Any = None,
        minus: Any = None,
        cp: Any = None,
        sigmas: Any = None,
        cpk: Any = None,
        towards: Literal["upper", "lower"] = "upper",
        shared_name: str | None = None,
    ):
        if towards not in ("upper", "lower"):
            raise ProblemError(f'Toleranced: \'towards\' is "upper" or "lower"; received {towards!r}.')
        self.towards = towards
        if cp is None and sigmas is None:
            cp = 1.0
        zone = {"nominal": nominal, "tolerance": tolerance, "plus": plus, "minus": minus}
        self.set_parameters(zone | {"cp": cp, "sigmas": sigmas, "cpk": cpk}, shared_name)

    @override
    def canonical(self) -> Canonical:
        location, scale, _ = super().canonical()
        middle = _zone(self.parameters).middle
        return Canonical(location if self.towards == "upper" else middle - (location - middle), scale)

    def limits(self) -> tuple[Scalar, Scalar]:
        """Lower and upper limit of the tolerance zone, once the parameters are plain numbers."""
        nominal, plus, minus = _zone(self.parameters)
        return nominal - minus, nominal + plus

    @override
    def reach(self) -> tuple[float, float]:
        """From one limit of the zone to the other."""
        capability = {name: self.parameters[name] for name in ("cp", "sigmas", "cpk") if name in self.parameters}
        if any(isinstance(value, AbstractLeaf) for value in capability.values()):
            return super().reach()  # where the zone lies in the germ would be decided
        sigmas = float(capability.get("sigmas", 3 * capability.get("cp", 0.0)))
        shift = sigmas - 3 * float(capability.get("cpk", sigmas / 3))
        low, high = -sigmas - shift, sigmas - shift
        return (low, high) if self.towards == "upper" else (-high, -low)

    def _is_possible(self, parameters: dict[str, float], shape: tuple[float, ...]) -> bool:
        del shape
        capability = parameters.get("sigmas", parameters.get("cp", 0.0))
        is_capable = 0 < capability < np.inf and parameters.get("cpk", -np.inf) <= capability
        return is_capable and float(_zone(parameters).half_width) >= 0


_NUMBER = r"\d+(?:\.\d*)?(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?"
_SYMMETRIC = re.compile(rf"([+-]?(?:{_NUMBER}))(?:±|\+/-|\+-)({_NUMBER})")
_DEVIATION = rf"(/?[+-](?:{_NUMBER})|/0)"
_ASYMMETRIC = re.compile(rf"([+-]?(?:{_NUMBER})){_DEVIATION}{_DEVIATION}")


def toleranced(text: str, **options: Any) -> Toleranced:
    """A toleranced dimension as a drawing writes it: `toleranced("27.645 +0.05/-0.02", cp=1.33)`.

    Accepted forms are `27.645 ±0.05`, `11.43 +/- 0.01`, and two signed deviations from the nominal value in any order:
    `27.645 +0.05/-0.02`, `20 -0.007/-0.028`, `8 +0.1 0`. `options` are those of `Toleranced`.
    """
    if not isinstance(text, str):
        raise refusal("toleranced", "a dimension as a drawing writes it, such as '11.43 ±0.01'", text)
    compact = re.sub(r"\s+(?=[^\d.])|(?<=[^\d.])\s+", "", text.strip().replace("\N{MINUS SIGN}", "-"))
    if match := _SYMMETRIC.fullmatch(compact):
        nominal, tolerance = map(float, match.groups())
        return Toleranced(nominal, tolerance=tolerance, **options)
    if match := _ASYMMETRIC.fullmatch(compact.replace(" ", "/")):
        nominal, *deviations = (float(number.removeprefix("/")) for number in match.groups())
        return Toleranced(nominal, plus=max(deviations), minus=-min(deviations), **options)
    raise ProblemError(
        f"{text!r} is no toleranced dimension: expected a nominal value with '±0.05', '+/- 0.05' or two signed "
        "deviations like '+0.05/-0.02', with decimal points and without a unit."
    )
