"""A simulator that is not ours, as the model of an uncertainty analysis: a pendulum integrated by SciPy.

Samples run in two processes, and those that have finished are kept in `pendulum.jsonl`: end the script and start it
again, and it goes on. The same points could be answered by anyone, anywhere: they are written to `points.csv`.
"""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from scipy.integrate import solve_ivp

import aleator as al

GRAVITY = 9.81


def swing(at):
    """A uniform rod, hinged at its end, released at 1 rad: its first period in s, and its angle after 5 s in rad."""
    mass, length, damping = at["mass"], at["length"], at["damping"]
    inertia = mass * length**2 / 3

    def rates(_, state):
        torque = -mass * GRAVITY * length / 2 * np.sin(state[0]) - damping * state[1]
        return state[1], torque / inertia

    def vertical(_, state):
        return state[0]

    motion = solve_ivp(rates, (0.0, 5.0), (1.0, 0.0), events=vertical, rtol=1e-9, atol=1e-10)
    first, _, third = motion.t_events[0][:3]
    return {"period": third - first, "angle": motion.y[0, -1]}


def main():
    """The period and the last angle: how uncertain, and because of what. Returns the expansion."""
    uncertain = {
        "mass": al.Normal(1.0, 0.02),  # kg
        "length": al.Uniform(1.0, half_width=0.01),  # m
        "damping": al.Uniform(0.1, half_width=0.03),  # N m s/rad
    }
    expansion = al.Expansion(order=3)
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as executor:
        box = al.foreign.BlackBox(swing, executor=executor, retries=1, journal="pendulum.jsonl")
        expanded = al.expand(box, uncertain, expansion)
    print(f"solved {len(expanded.collocation.points)} points")
    print(expanded)

    asked = al.foreign.ask(uncertain, expansion)
    asked.write_csv("points.csv")
    rows = [swing(dict(zip(asked.points, row, strict=True))) for row in zip(*asked.points.values(), strict=True)]
    told = asked.tell({name: np.array([row[name] for row in rows]) for name in ("period", "angle")})
    print("answered elsewhere, the same:", float(told["period"].std) == float(expanded["period"].std))
    return expanded


if __name__ == "__main__":
    main()
