"""Andrews' squeezing mechanism: seven bodies in three closed loops, driven through two turns in 30 ms.

Schiehlen (1990); Test Set for IVP Solvers, problem "andrews", whose published end is `END`, `RATES` and `FORCES`.
"""

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al

# kg and kg·m² of the bodies 1 to 7; then lengths in m, N/m and N·m.
MASS = (0.04325, 0.00365, 0.02373, 0.00706, 0.07050, 0.00706, 0.05498)
INERTIA = (2.194e-6, 4.410e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5)
A, B, C = np.array([-0.06934, -0.00227]), np.array([-0.03635, 0.03273]), np.array([0.014, 0.072])
RR, RA, D, DA, E, EA = 0.007, 0.00092, 0.028, 0.0115, 0.02, 0.01421
SS, SA, SB, SC, SD = 0.035, 0.01874, 0.01043, 0.018, 0.02
TA, TB, U, UA, UB, ZF, ZT, FA = 0.02308, 0.00916, 0.04, 0.01228, 0.00449, 0.02, 0.04, 0.01421
STIFFNESS, RELAXED, TORQUE = 4530.0, 0.07785, 0.033

NAMES = ("beta", "theta", "gamma", "phi", "delta", "omega", "epsilon")
START = (-0.0617138900142764, 0.0, 0.455279819163070, 0.222668390165886, 0.487364979543843, -0.222668390165886)
START = (*START, 1.23054744454982)
END = (15.81077119629904, -15.75637105984298, 0.04082224013073101, -0.5347301163226948, 0.5244099658805304)
END = (*END, 0.5347301163226948, 1.048080741042263)
RATES = {"beta_rate": 1139.920302151208, "theta_rate": -1424.379294994111, "beta_acceleration": -24631.76316945196}
FORCES = (199.1753333731910, -29.75531228015052, 23.06654119098399, 31.45271365475927, 22.64249232082739)
FORCES = (*FORCES, 11.61740700019673)


def spring(end):
    """The force on its moving end."""
    along = end - C
    length = jnp.sqrt(along @ along)
    return -STIFFNESS * (length - RELAXED) / length * along


class Bodies(al.Multibody):
    """Bodies, each named after its angle, with three pins at one point."""

    gravity = (0.0, 0.0, 0.0)
    actuators = ("beta_torque",)

    def bodies(self):
        def body(name, number, center, position=(0.0, 0.0), parent=None):
            return al.Body(
                name,
                parent=parent,
                joint=al.joints.Revolute("z"),
                mass=MASS[number - 1],
                inertia=(0.0, 0.0, INERTIA[number - 1]),
                center=(*center, 0.0),
                position=(*position, 0.0),
            )

        return (
            body("beta", 1, (RA, 0.0)),
            body("theta", 2, (-DA, 0.0), (RR, 0.0), "beta"),
            body("gamma", 3, (SB, -SA), B),
            body("delta", 5, (TA, -TB), A),
            body("phi", 4, (0.0, EA - E), (ZT, 0.0), "delta"),
            body("epsilon", 7, (UB, -UA), A),
            body("omega", 6, (ZF - FA, 0.0), (0.0, -U), "epsilon"),
        )

    def closures(self):
        ends = {"gamma": (0.0, -SS, 0.0), "phi": (0.0, -E, 0.0), "omega": (ZF, 0.0, 0.0)}
        return tuple(
            al.joints.Closure(
                f"pin_{name}",
                parent="theta",
                position=(-D, 0.0, 0.0),
                child=name,
                child_position=end,
                joint=al.joints.Revolute("z"),
                planar=True,
            )
            for name, end in ends.items()
        )

    def body_loads(self, q, v):
        at = (SD, -SC, 0.0)
        force = spring(self.point(q, "gamma", at)[:2])
        return (al.BodyLoad("gamma", jnp.append(force, 0.0), at=at),)


def pin_forces(model, found):
    """The multipliers at the end, in the axes of the world: they are in those of body 2."""
    turn = END[0] + END[1]
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    multipliers = [found[f"{name}_multiplier"][-1] for name in model.constraints]
    return np.ravel(np.reshape(multipliers, (3, 2)) @ axes.T)


@pytest.mark.slow
def test_the_squeezer_ends_as_published():
    model = Bodies()
    posture = dict(zip(NAMES, START, strict=True))
    beta = {"beta": posture.pop("beta")}
    torque = al.PowerSeries(start=([TORQUE],))
    system = al.ForwardDynamics(model, torque=torque, start=beta, guess=posture)
    found = al.simulate(system, al.Grid(0.03, 3000))
    assert [found[name][-1] for name in NAMES] == pytest.approx(END, abs=1e-5)
    assert {name: found[name][-1] for name in RATES} == pytest.approx(RATES, rel=1e-5)
    assert pin_forces(model, found) == pytest.approx(FORCES, rel=1e-4)
    assert np.max(found["constraint_error"]) < 1e-9
