"""`simulate` tells of outputs that are not finite."""

import jax
import numpy as np
import pytest

import aleator as al


class Tank(al.System):
    """Its level has no solution: the square of a number is never negative."""

    states = ("x",)
    algebraic = ("level",)

    def rhs(self, t, z):
        return (z.level,)

    def residual(self, t, z):
        return (z.level**2 + 1.0,)

    def outputs(self, t, z):
        return {"x": z.x}


class Explosion(al.System):
    """x' = x², which is infinite at t = 1 / x(0)."""

    states = ("x",)

    start: al.Number = 1.0

    def initial(self):
        return {"x": self.start}

    def rhs(self, t, z):
        return (z.x**2,)

    def outputs(self, t, z):
        return {"x": z.x, "constant": 1.0}


def test_equations_without_a_solution_are_named_with_the_remedy():
    with pytest.warns(al.SimulationWarning, match=r"Tank: output 'x' is not finite at t = 0\.1 s.*no solution"):
        found = al.simulate(Tank(), al.Grid(1.0, 10))
    assert np.isnan(found["x"][-1])


def test_what_runs_away_is_named_at_its_first_time():
    with pytest.warns(al.SimulationWarning, match=r"Explosion: output 'x' is not finite at t = (\d+\.?\d*) s") as told:
        found = al.simulate(Explosion(), al.Grid(40.0, 40))
    first = int(np.argmax(~np.isfinite(found["x"])))
    assert first > 0
    assert f"t = {first} s" in str(told[0].message)


def test_what_stays_finite_or_is_traced_is_not_warned_of():
    al.simulate(Explosion(), al.Grid(0.5, 10))
    traced = jax.jit(lambda start: al.simulate(Explosion(start), al.Grid(40.0, 40))["x"])(1.0)
    assert not np.isfinite(traced[-1])
