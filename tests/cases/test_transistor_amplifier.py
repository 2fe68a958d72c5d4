"""The transistor amplifier: a stiff system of index one, with exponentials of voltage / 26 mV.

Test Set for IVP Solvers, problem "transamp", whose published end is `END`.
"""

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al

SUPPLY, ALPHA, SOURCE, RESISTANCE = 6.0, 0.99, 1000.0, 9000.0

# y1 to y8 at 0.03 s (SciPy's Radau to 1e-7) and 0.2 s (published), V.
EARLY = {"y1": -0.0055546, "y5": 2.2570641, "y8": 0.2425635}
END = (-0.5562145012262709e-2, 3.006522471903042, 2.849958788608128, 2.926422536206241)
END = (*END, 2.704617865010554, 2.761837778393145, 4.770927631616772, 1.236995868091548)


class Amplifier(al.System):
    """Its states are the voltages of the five capacitors, of which two are grounded."""

    states = ("c1", "c2", "c3", "c4", "c5")
    algebraic = ("y1", "y4", "y7")

    def initial(self):
        return {"c1": 3.0, "c2": 3.0, "c3": -3.0, "c4": 3.0, "c5": -6.0}

    def algebraic_guess(self, t, z):
        return {"y4": SUPPLY, "y7": SUPPLY}

    def voltages(self, z):
        return (z.y1, z.y1 + z.c1, z.c2, z.y4, z.y4 + z.c3, z.c4, z.y7, z.y7 + z.c5)

    def currents(self, t, z):
        """Out of each node."""
        y1, y2, y3, y4, y5, y6, y7, y8 = self.voltages(z)
        first, second = (1e-6 * jnp.expm1(across / 0.026) for across in (y2 - y3, y5 - y6))
        return (
            (y1 - 0.1 * jnp.sin(200 * np.pi * t)) / SOURCE,
            y2 / RESISTANCE + (y2 - SUPPLY) / RESISTANCE + (1 - ALPHA) * first,
            y3 / RESISTANCE - first,
            (y4 - SUPPLY) / RESISTANCE + ALPHA * first,
            y5 / RESISTANCE + (y5 - SUPPLY) / RESISTANCE + (1 - ALPHA) * second,
            y6 / RESISTANCE - second,
            (y7 - SUPPLY) / RESISTANCE + ALPHA * second,
            y8 / RESISTANCE,
        )

    def rhs(self, t, z):
        f = self.currents(t, z)
        return tuple(-f[node] / (farads * 1e-6) for farads, node in enumerate((1, 2, 4, 5, 7), start=1))

    def residual(self, t, z):
        f = self.currents(t, z)
        return f[0] + f[1], f[3] + f[4], f[6] + f[7]

    def outputs(self, t, z):
        return {f"y{node}": voltage for node, voltage in enumerate(self.voltages(z), start=1)}


@pytest.mark.slow
def test_the_amplifier_ends_as_published():
    found = al.simulate(Amplifier(), al.Grid(0.2, 1000), integrator=al.integrators.Rodas5P())
    assert {name: found[name][150] for name in EARLY} == pytest.approx(EARLY, rel=1e-5)
    assert [found[f"y{node}"][-1] for node in range(1, 9)] == pytest.approx(END, rel=1e-6)
