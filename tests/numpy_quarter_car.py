"""An independent quarter car: plain NumPy, its own Runge-Kutta method, written from equations (102) and (103)."""

from importlib import resources

import numpy as np

STEP, STEPS = 1e-3, 2800


def read_road():
    """Ground height at the instants and between them: shape (2 * STEPS + 1,)."""
    text = (resources.files("aleator.studies.suspension") / "road.csv").read_text()
    lines = [line for line in text.splitlines() if not line.startswith("#")][1:]
    table = np.array([[float(cell) for cell in line.split(",")] for line in lines])
    return np.interp(np.arange(2 * STEPS + 1) * STEP / 2, table[:, 0], table[:, 1])


def quarter_car(m_s, k_s, b_s, eta, k_u, m_u=94.0):
    """Ride, holding and the history of travel of any number of cars: shapes (cars,), (cars,), (instants, cars)."""
    m_s, k_s, b_s, eta, k_u = np.broadcast_arrays(*np.atleast_1d(m_s, k_s, b_s, eta, k_u))
    ground = read_road()

    def acceleration(z):
        speed = z[1] - z[3]
        force = k_s * (z[0] - z[2]) + b_s * np.where(speed < 0, eta, 1.0) * speed
        return -force / m_s, force

    def rate(z, height):
        # Ride and holding are further states, integrated as the others are.
        a_s, force = acceleration(z)
        a_u = (force - k_u * (z[2] - height)) / m_u
        return np.stack([z[1], a_s, z[3], a_u, a_s**2, (z[2] - height) ** 2])

    z = np.zeros((6, len(m_s)))
    travel = np.zeros((STEPS + 1, len(m_s)))
    for i in range(STEPS):
        here, middle, there = ground[2 * i : 2 * i + 3]
        a = rate(z, here)
        b = rate(z + STEP / 2 * a, middle)
        c = rate(z + STEP / 2 * b, middle)
        d = rate(z + STEP * c, there)
        z = z + STEP / 6 * (a + 2 * b + 2 * c + d)
        travel[i + 1] = z[0] - z[2]
    return z[4], np.sqrt(z[5] / (STEP * STEPS)), travel
