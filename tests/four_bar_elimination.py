"""Linkages by elimination: postures from a triangle, random ones, and a count of those that leave the zone.

The loop is known as a triangle alone: all this is independent of the constraints, multipliers and expansions that it
verifies.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

import aleator as al
from aleator.studies.four_bar import ANGLES, HEIGHT, LENGTHS, SIGMAS, TRANSMISSION, ZONE

ALONG_STROKE = 81
AT_ONCE = 20_000
LEVELS = (0.5, 0.95, 0.99)


class Posture(NamedTuple):
    """Pins and tool of linkages at some crank angles, mm, shape (..., 2), and the angle of transmission, degrees."""

    crank_pin: np.ndarray
    rocker_pin: np.ndarray
    tool: np.ndarray
    transmission: np.ndarray


class Counts(NamedTuple):
    """What was counted of a design.

    - `outside`: linkages whose tool leaves the given zone somewhere on the stroke; `flat`: those whose angle of
      transmission is too small somewhere;
    - `zone`: half the width of the zone in which `SIGMAS` standard deviations stay at each place of the stroke, mm;
    - `largest`: the largest deviation of the tool on the stroke that half, 95 %, and 99 % of the linkages keep, mm.
    """

    outside: al.results.Proportion
    flat: al.results.Proportion
    zone: float
    largest: tuple[float, float, float]


def posture(
    angle: Float[np.ndarray, "..."],
    lengths: Mapping[str, Float[np.ndarray, "..."]],
    crank_offset: Float[np.ndarray, "... 2"],
    rocker_offset: Float[np.ndarray, "... 2"],
) -> Posture:
    """A linkage at a crank angle, from the triangle of coupler, rocker and the line that joins their other ends.

    The offsets are the places of both pins in their clearances, mm; everything broadcasts.
    """
    pin = lengths["crank"][..., None] * _unit(angle) + crank_offset
    ground = np.stack([lengths["ground"], np.zeros_like(lengths["ground"])], axis=-1)
    line = ground - pin - rocker_offset
    reach, b, c = np.hypot(line[..., 0], line[..., 1]), lengths["coupler"], lengths["rocker"]
    coupler = np.arctan2(line[..., 1], line[..., 0]) + np.arccos((b**2 + reach**2 - c**2) / (2 * b * reach))
    tool = (
        pin + lengths["along"][..., None] * _unit(coupler) + lengths["across"][..., None] * _unit(coupler + np.pi / 2)
    )
    end = pin + rocker_offset + b[..., None] * _unit(coupler)
    transmission = np.rad2deg(np.arccos((b**2 + c**2 - reach**2) / (2 * b * c)))
    return Posture(pin, end, tool, transmission)


def posture_of(lengths: Mapping[str, float], angles: np.ndarray) -> Posture:
    """The mean linkage of some lengths (mm) at crank angles."""
    none = np.zeros(2)
    return posture(angles, {name: np.asarray(one) for name, one in lengths.items()}, none, none)


def drawn_postures(
    lengths: Mapping[str, float], widths: Mapping[str, float], count: int, *, seed: int, instants: np.ndarray
) -> Posture:
    """Random linkages of some lengths and widths (mm), at some crank angles: shapes (linkages, angles)."""
    generator = np.random.default_rng(seed)
    parts = {
        name: (lengths[name] + widths[f"{name}.tolerance"] / 3 * generator.standard_normal(count))[:, None]
        for name in LENGTHS
    }
    seats = [widths[play] / 3 * generator.standard_normal((count, 1, 2)) for play in ("crank_play", "rocker_play")]
    return posture(instants, parts, *seats)


def crank_angles(count: int = ALONG_STROKE) -> Float[np.ndarray, " angles"]:
    """Angles of the crank from one end of the stroke to the other, rad."""
    return np.linspace(*ANGLES, count)


def count_linkages(
    lengths: Mapping[str, float],
    widths: Mapping[str, float],
    samples: int,
    *,
    seed: int = 3,
) -> Counts:
    """Assemble `samples` linkages of normal dimensions, and count those that leave the zone or transmit badly."""
    largest, smallest, sums = [], [], np.zeros((2, ALONG_STROKE))
    for done in range(0, samples, AT_ONCE):
        count = min(AT_ONCE, samples - done)
        found = drawn_postures(lengths, widths, count, seed=seed + done, instants=crank_angles())
        deviation = found.tool[..., 1] - HEIGHT
        sums += np.sum(deviation, axis=0), np.sum(deviation**2, axis=0)
        largest.append(np.abs(deviation).max(axis=1))
        smallest.append(found.transmission.min(axis=1))
    mean, square = sums / samples
    away, least = np.concatenate(largest), np.concatenate(smallest)
    return Counts(
        outside=al.results.Proportion(int(np.sum(away > ZONE)), samples),
        flat=al.results.Proportion(int(np.sum(least < TRANSMISSION)), samples),
        zone=float(np.max(np.abs(mean) + SIGMAS * np.sqrt(np.maximum(square - mean**2, 0.0)))),
        largest=tuple(np.quantile(away, LEVELS).tolist()),
    )


def _unit(angle: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)
