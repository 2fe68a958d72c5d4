"""A four-bar linkage that guides a tool along a straight line: robust lengths, and the cheapest tolerances.

Hoeken's linkage: the crank swings half a turn, from 90° to 270°, and a point of the coupler follows a line of 400 mm. A
servomotor drives it from rest to rest; the way back is the same motion reversed, with the same forces. The loop is
closed by two constraints, whose multipliers are the force in the rocker's pin. Lengths vary within their tolerances,
and each pin sits somewhere in its clearance.

The three designs are one problem that differs only in numbers, so that all are solved by one compiled program. Lengths
in mm, forces and masses in SI units.
"""

import math
import operator
from collections.abc import Mapping
from functools import reduce
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

import aleator as al

STROKE, HEIGHT, ZONE = 400.0, 440.0, 0.5
"""The line wanted: its length, its height above the bearings, and how far the tool may leave it, mm."""

DURATION, STEPS = 0.4, 40
"""Of one stroke, s."""

ANGLES = (math.pi / 2, 3 * math.pi / 2)
"""Of the crank at both ends of the stroke, rad; it rests there."""

TRANSMISSION, FORCE, TORQUE = 51.0, 122.0, 7.5
"""The smallest angle between coupler and rocker, °, the largest force in a pin, N, and the largest torque, N m."""

SIGMAS = 3.2
"""The margin of every limit: more than three, since a linkage may break a limit anywhere on its way."""

LENGTHS = {"crank": 95.7, "coupler": 267.9, "rocker": 267.9, "ground": 210.5, "along": 535.8, "across": 0.0}
"""Hoeken's linkage for half a turn and this stroke, mm: ratios 2.2 and 2.8 (Norton, Design of Machinery, chapter 3)."""

WIDTHS = {f"{name}.tolerance": 0.1 for name in LENGTHS} | {"crank_play": 0.05, "rocker_play": 0.05}
"""The given tolerances and radial clearances, mm: three standard deviations."""

PRICES = {
    **dict.fromkeys(("crank.tolerance", "rocker.tolerance", "across.tolerance"), 0.1),
    **dict.fromkeys(("coupler.tolerance", "ground.tolerance", "along.tolerance"), 0.2),
    **dict.fromkeys(("crank_play", "rocker_play"), 0.05),
}
"""The price of each width, $ mm: assumed, and dearer where distances are long."""

TIGHTEST, WIDEST = 0.005, 0.5

G = 9.81


class FourBar(al.Mechanical):
    """Crank, coupler and rocker as homogeneous bars in the vertical plane, a tool at a point of the coupler.

    Angles of the bars are measured from the horizontal. The loop is closed at the rocker's pin.

    - `zone`: how far the tool may leave its line, mm;
    - `crank`, `coupler`, `rocker`, `ground`: distances between pins and bearings, mm;
    - `along`, `across`: the tool on the coupler, from the crank's pin, mm;
    - `crank_play`, `rocker_play`: radial clearances of both pins, mm; `crank_seat`, `rocker_seat`: the place of each
      pin in its clearance, as a fraction of it, in the axes of the ground;
    - `tool`: its mass, kg; `density`: of the bars, kg/m.
    """

    names = ("crank", "coupler", "rocker")
    actuator_names = ("crank_torque",)
    constraint_names = ("pin_x", "pin_y")
    units: ClassVar[Mapping[str, str]] = {
        "x": "mm",
        "deviation": "mm",
        "transmission": "°",
        "crank_pin": "N",
        "rocker_pin": "N",
        "crank_torque": "N m",
    }

    zone: al.Number
    crank: al.Number
    coupler: al.Number
    rocker: al.Number
    ground: al.Number
    along: al.Number
    across: al.Number
    crank_play: al.Number = 0.0
    rocker_play: al.Number = 0.0
    crank_seat: tuple[al.Number, al.Number] = (0.0, 0.0)
    rocker_seat: tuple[al.Number, al.Number] = (0.0, 0.0)
    tool: al.Number = 2.0
    density: al.Number = 2.0

    def mass_matrix(self, q: Float[Array, " 3"]) -> Float[Array, "3 3"]:
        """That of the angles: the coupler with its tool hangs on the crank's pin."""
        bodies, crank = self.bodies(), 1e-3 * self.crank
        coupled = crank * normal(q[0]) @ turned(self.first_moment(q))
        first = (bodies.crank / 3 + bodies.carried) * crank**2
        third = bodies.rocker * (1e-3 * self.rocker) ** 2 / 3
        return (
            jnp.zeros((3, 3))
            .at[[0, 0, 1, 1, 2], [0, 1, 0, 1, 2]]
            .set(jnp.stack([first, coupled, coupled, bodies.inertia, third]))
        )

    @override
    def bias(self, q: Float[Array, " 3"], v: Float[Array, " 3"]) -> Float[Array, " 3"]:
        bodies, crank, moment = self.bodies(), 1e-3 * self.crank, self.first_moment(q)
        weight = G * crank * jnp.cos(q[0]) * (bodies.crank / 2 + bodies.carried)
        first = -crank * normal(q[0]) @ moment * v[1] ** 2 + weight
        second = -crank * unit(q[0]) @ turned(moment) * v[0] ** 2 + G * moment[0]
        third = G * bodies.rocker * 1e-3 * self.rocker / 2 * jnp.cos(q[2])
        return jnp.stack([first, second, third])

    def bodies(self) -> "Bodies":
        """Masses and moments of inertia."""
        long = 1e-3 * jnp.sqrt(self.along**2 + self.across**2)
        crank, coupler, rocker = (self.density * length for length in (1e-3 * self.crank, long, 1e-3 * self.rocker))
        carried, moment = coupler + self.tool, coupler / 2 + self.tool
        return Bodies(crank, rocker, carried, moment, (coupler / 3 + self.tool) * long**2)

    def first_moment(self, q: Float[Array, " 3"]) -> Float[Array, " 2"]:
        """Of coupler and tool about the crank's pin, kg m."""
        return 1e-3 * self.bodies().moment * self.arm(q)

    def arm(self, q: Float[Array, " 3"]) -> Float[Array, " 2"]:
        """From the crank's pin to the tool, mm."""
        return self.along * unit(q[1]) + self.across * normal(q[1])

    def crank_end(self, q: Float[Array, " 3"]) -> Float[Array, " 2"]:
        """The crank's pin in the coupler, mm."""
        return self.crank * unit(q[0]) + self.crank_play * jnp.stack(self.crank_seat)

    @override
    def constraint(self, q: Float[Array, " 3"]) -> Float[Array, " 2"]:
        end = self.crank_end(q) + self.coupler * unit(q[1]) + self.rocker_play * jnp.stack(self.rocker_seat)
        return 1e-3 * (end - self.rocker * unit(q[2])).at[0].add(-self.ground)

    @override
    def constraint_jacobian(self, q: Float[Array, " 3"]) -> Float[Array, "2 3"]:
        lengths = self.crank, self.coupler, -self.rocker
        return 1e-3 * jnp.stack([length * normal(angle) for length, angle in zip(lengths, q, strict=True)], axis=1)

    def crank_pin(self, motion: al.Motion) -> Float[Array, " 2"]:
        """The force of the crank on the coupler, N: Newton's second law for coupler and tool."""
        q, v, a = motion.q, motion.v, motion.v_dot
        bodies, moment = self.bodies(), self.first_moment(q)
        pin = 1e-3 * self.crank * (a[0] * normal(q[0]) - v[0] ** 2 * unit(q[0])) + jnp.array([0.0, G])
        return bodies.carried * pin + a[1] * turned(moment) - v[1] ** 2 * moment + motion.multipliers

    @override
    def outputs(self, motion: al.Motion) -> dict[str, Any]:
        q = motion.q
        x, y = self.crank_end(q) + self.arm(q)
        crank_pin, rocker_pin = self.crank_pin(motion), motion.multipliers
        return {
            "x": x,
            "deviation": y - HEIGHT,
            "transmission": jnp.rad2deg(q[2] - q[1]),
            "crank_pin": jnp.sqrt(crank_pin @ crank_pin),
            "rocker_pin": jnp.sqrt(rocker_pin @ rocker_pin),
        }


class Bodies(NamedTuple):
    """Masses of crank and rocker, mass carried by the crank's pin, kg; its first moment over the arm's length, kg, and
    its moment of inertia about the pin, kg m².
    """

    crank: Any
    rocker: Any
    carried: Any
    moment: Any
    inertia: Any


def unit(angle: Any) -> Float[Array, " 2"]:
    """The direction of an angle."""
    return jnp.stack([jnp.cos(angle), jnp.sin(angle)])


def normal(angle: Any) -> Float[Array, " 2"]:
    """The direction a right angle ahead of an angle."""
    return turned(unit(angle))


def turned(vector: Float[Array, " 2"]) -> Float[Array, " 2"]:
    """A vector turned by a right angle."""
    return jnp.stack([-vector[1], vector[0]])


def driven(model: FourBar) -> al.InverseDynamics:
    """A linkage whose crank swings from rest to rest."""
    swing = al.PowerSeries(start=(ANGLES[0], 0.0, 0.0), end=(ANGLES[1], 0.0, 0.0))
    return al.InverseDynamics(model, motion={"crank": swing}, guess={"coupler": 0.7, "rocker": 1.6})


COST = reduce(operator.add, (al.cost.reciprocal(name, bias=0.0, scale=price) for name, price in PRICES.items()))
"""What tolerances and clearances cost to make, $: the sum of price over width."""


def problem(widths: Mapping[str, Any], *, zone: float, weight: float, sigmas: float) -> al.Problem:
    """The narrowest zone about the line, by `weight`, beside the cost of the widths.

    - `widths`: tolerances and clearances by name, mm, each a decision; `zone`: the widest allowed, mm;
    - `sigmas`: the margin of every limit.
    """
    model = FourBar(
        zone=al.Decision(0.4, 0.0, 20.0),
        **{name: al.Toleranced(_length(name), tolerance=widths[f"{name}.tolerance"]) for name in LENGTHS},
        crank_play=widths["crank_play"],
        rocker_play=widths["rocker_play"],
        crank_seat=_seat(),
        rocker_seat=_seat(),
        tool=al.Normal(2.0, std=0.1),
    )
    deviation, half, near, far = al.path("deviation"), al.value("zone"), al.terminal("x"), al.peak("x")
    return al.Problem(
        driven(model),
        grid=al.Grid(DURATION, STEPS),
        minimize=COST + weight * half,
        subject_to=[
            (deviation.mean + sigmas * deviation.std - half <= 0).named("line"),
            (deviation.mean - sigmas * deviation.std + half >= 0).named("line"),
            (half <= zone).named("zone"),
            # The tool begins at its largest distance, and ends at its smallest.
            ((far.mean - sigmas * far.std) - (near.mean + sigmas * near.std) >= STROKE).named("stroke"),
            al.path("transmission").at_least(TRANSMISSION, sigmas=sigmas).named("transmission"),
            al.path("crank_pin").at_most(FORCE, sigmas=sigmas).named("crank pin"),
            al.path("rocker_pin").at_most(FORCE, sigmas=sigmas).named("rocker pin"),
            al.path("crank_torque").within(-TORQUE, TORQUE, sigmas=sigmas).named("torque"),
        ],
        # Where a pin's force almost vanishes its size is curved, and its derivatives by tolerances are off by 8 %.
        expansion=al.Expansion(order=1, tolerance=0.15),
    )


def robust_problem(sigmas: float = SIGMAS) -> al.Problem:
    """uOpt: the lengths for which all linkages of the given tolerances stay in the narrowest zone."""
    return problem(
        {name: al.Decision(one, one, one) for name, one in WIDTHS.items()}, zone=20.0, weight=1.0, sigmas=sigmas
    )


def nominal_problem() -> al.Problem:
    """dOpt: the same for the mean linkage alone."""
    return robust_problem(sigmas=0.0)


def allocation_problem(zone: float = ZONE) -> al.Problem:
    """aOpt: the cheapest tolerances and clearances, with the lengths that suit them, for a given zone (mm)."""
    widths = {name: al.Decision(one, TIGHTEST, WIDEST) for name, one in WIDTHS.items()}
    return problem(widths, zone=zone, weight=0.0, sigmas=SIGMAS)


def _length(name: str) -> al.Decision:
    start = LENGTHS[name]
    lower, upper = (-50.0, 50.0) if name == "across" else (0.85 * start, 1.15 * start)
    return al.Decision(start, lower, upper)


def _seat() -> tuple[al.Toleranced, al.Toleranced]:
    return al.Toleranced(0.0, tolerance=1.0), al.Toleranced(0.0, tolerance=1.0)
