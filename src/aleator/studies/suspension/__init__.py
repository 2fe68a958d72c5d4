"""Suspension of a quarter car: robust design and optimal apportionment (dissertation, sections 6.4 and 7.4).

A passive suspension carries a car over four bumps. A soft, weakly damped one rides well but needs travel; road holding
needs damping. Five parameters are uncertain. The three designs are one problem with decisions in different places.
"""

from importlib import resources
from typing import Any, ClassVar

import jax.numpy as jnp

import aleator as al


class QuarterCar(al.System):
    """A quarter car with a damper that is stiffer in compression than in extension (equations 102 and 103)."""

    states = ("z_s", "v_s", "z_u", "v_u")
    units: ClassVar = {"z_s": "m", "z_u": "m", "travel": "m", "comfort": "m²/s⁴", "grip": "m"}

    m_s: al.Number = al.parameter("kg", positive=True)
    m_u: al.Number = al.parameter("kg", positive=True)
    k_s: al.Number = al.parameter("N/m", positive=True)
    b_s: al.Number = al.parameter("N s/m")
    eta: al.Number = al.parameter("-", positive=True)
    k_u: al.Number = al.parameter("N/m", positive=True)

    def accelerations(self, z: Any, road: Any) -> tuple[Any, Any]:
        """The accelerations of the sprung and the unsprung mass, m/s²; positions are measured from equilibrium."""
        closing = z.v_s - z.v_u
        damping = self.b_s * jnp.where(closing >= 0, closing, self.eta * closing)
        suspension = self.k_s * (z.z_s - z.z_u) + damping
        tyre = self.k_u * (z.z_u - road)
        return -suspension / self.m_s, (suspension - tyre) / self.m_u

    def rhs(self, t: Any, z: Any, road: Any) -> tuple[Any, ...]:
        """Equation (102) as a system of first order."""
        a_s, a_u = self.accelerations(z, road)
        return z.v_s, a_s, z.v_u, a_u

    def outputs(self, t: Any, z: Any, road: Any) -> dict[str, Any]:
        """Positions, suspension travel, squared acceleration of the passenger, deflection of the tyre."""
        a_s, _ = self.accelerations(z, road)
        return {"z_s": z.z_s, "z_u": z.z_u, "travel": z.z_s - z.z_u, "comfort": a_s**2, "grip": z.z_u - road}


def road() -> al.Tabulated:
    """Height of the ground (m) over time (s): four bumps and noise (figure 6.2)."""
    with resources.as_file(resources.files("aleator.studies.suspension") / "road.csv") as path:
        return al.Tabulated.from_csv(path, time="time_s", value="height_m")


def nominal(k_s: Any = 3750.0, b_s: Any = 250.0, eta: Any = 0.17375) -> QuarterCar:
    """The car of table 6.1: five uncertain numbers, of which the means of spring and damper are to be chosen.

    The half-widths of spring, damper and damping ratio may be decisions.
    """
    return QuarterCar(
        m_s=al.Uniform(376.0, half_width=47.0),
        m_u=94.0,
        k_s=al.Uniform(al.Decision(30e3, 23_339.0, 300e3), half_width=k_s),
        b_s=al.Uniform(al.Decision(2000.0, 1.0, 50e3), half_width=b_s),
        eta=al.Uniform(1.39, half_width=eta),
        k_u=al.Uniform(200e3, half_width=25e3),
    )


def apportioned() -> QuarterCar:
    """The same car with the spreads of spring, damper and damping ratio to be chosen as well (section 7.4.1)."""
    return nominal(
        k_s=al.Decision(3750.0, 187.5, 15e3),
        b_s=al.Decision(250.0, 12.5, 1000.0),
        eta=al.Decision(0.17375, 0.0086875, 0.695),
    )


GRID = al.Grid(t_final=2.8, steps=2800)
RIDE = al.integral("comfort")
POSITION_S, POSITION_U = al.path("z_s"), al.path("z_u")
TYRE = al.rms("grip")

COST = (
    al.cost.reciprocal_power("k_s.half_width", bias=0.50, scale=1.40e6, power=1.5)
    + al.cost.reciprocal_power("b_s.half_width", bias=0.75, scale=3.31e5, power=2.0)
    + al.cost.reciprocal_power("eta.half_width", bias=0.85, scale=0.733, power=1.0)
)
"""The manufacturing cost of the spreads, $: equation (125) with the numbers of table 7.3."""


def limits(travel: float, holding: float, sigmas: float) -> list[al.Constraint]:
    """Travel at all times as printed in (119), between -travel and travel; holding (120)."""
    extension = (POSITION_S.mean + sigmas * POSITION_S.std) - (POSITION_U.mean - sigmas * POSITION_U.std)
    compression = (POSITION_S.mean - sigmas * POSITION_S.std) - (POSITION_U.mean + sigmas * POSITION_U.std)
    return [
        (extension <= travel).named("travel"),
        (compression >= -travel).named("travel"),
        TYRE.at_most(holding, sigmas=sigmas).named("holding"),
    ]


def robust_problem(travel: float = 0.203, holding: float = 0.034, sigmas: float = 1.0) -> al.Problem:
    """uOpt: the best ride, mean plus spread, of a car that keeps `sigmas` standard deviations from its limits
    (116-120).

    `travel` (m) bounds the suspension at all times, `holding` (m) the rms deflection of the tyre.
    """
    return al.Problem(
        nominal(),
        grid=GRID,
        inputs={"road": road()},
        minimize=RIDE.mean + RIDE.std,
        subject_to=limits(travel, holding, sigmas),
        expansion=al.Expansion(order=3),
    )


def deterministic_problem(travel: float = 0.203, holding: float = 0.034) -> al.Problem:
    """dOpt: the best ride of the nominal car within its limits (113)."""
    return al.deterministic(robust_problem(travel, holding))


def apportionment_problem(
    travel: float = 0.203,
    holding: float = 0.034,
    ride: float = 220.0,
    sigmas: float = 1.0,
    ride_sigmas: float = 1.0,
) -> al.Problem:
    """aOpt: the cheapest spreads, chosen with the nominal design, that keep ride (m²/s³) and limits (126-128).

    `ride_sigmas` is the margin of ride, `sigmas` that of travel and holding.
    """
    return al.Problem(
        apportioned(),
        grid=GRID,
        inputs={"road": road()},
        minimize=COST,
        subject_to=[*limits(travel, holding, sigmas), RIDE.at_most(ride, sigmas=ride_sigmas).named("ride")],
        # So wide, order 3 misses the z_s of a car by 10 to 17 % of its σ; orders 4 and 5 give the same σ to 2e-4.
        expansion=al.Expansion(order=3, tolerance=0.2),
    )
