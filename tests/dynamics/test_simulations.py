"""`simulate`: one program serves the same equations with any numbers; what it cannot run is refused in words."""

import jax
import numpy as np
import pytest

import aleator as al
from aleator.dynamics._simulate import _HISTORY
from compiling import compiled
from zoo import Decay

GRID = al.Grid(1.0, 20)


def test_other_numbers_need_no_other_program():
    integrator = al.integrators.Tsit5(rtol=1e-10, atol=1e-12)
    before = _HISTORY.compilations
    for rate, start, end in ((1.0, 2.0, 1.0), (0.3, -1.0, 2.5), (2.0, 0.5, 0.7)):
        found = al.simulate(Decay(rate, start), al.Grid(end, 20), integrator=integrator)
        np.testing.assert_allclose(found["x"], start * np.exp(-rate * np.linspace(0.0, end, 21)), rtol=1e-7, atol=1e-9)
    assert _HISTORY.compilations - before == 1


PUSH = 1.0


class Pushed(Decay):
    """`x' = PUSH`, which the code reads from a global name."""

    def rhs(self, t, z):
        return (PUSH + 0.0 * z.x,)


def test_what_the_code_reads_may_change(monkeypatch):
    assert float(al.simulate(Pushed(0.0), GRID)["x"][-1]) == pytest.approx(2.0)
    monkeypatch.setattr("test_simulations.PUSH", 3.0)
    assert float(al.simulate(Pushed(0.0), GRID)["x"][-1]) == pytest.approx(4.0)


def test_impossible_numbers_are_refused_though_the_program_is_there():
    assert np.isfinite(al.simulate(Decay(1.0, 0.5), GRID)["x"]).all()
    with pytest.raises(al.ProblemError, match=r"'system.start': expected numbers; received nan"):
        al.simulate(Decay(1.0, np.nan), GRID)


class Named(al.System):
    """`x' = road + wind`, where outputs see the road alone."""

    states = ("x",)

    def rhs(self, t, z, road, **others):
        return (road + others.get("wind", 0.0),)

    def outputs(self, t, z, *, road=0.0):
        return {"x": z.x + road}


def test_each_method_is_given_the_inputs_that_it_names_and_no_others():
    one = al.Tabulated([0.0, 1.0], [1.0, 1.0])
    found = al.simulate(Named(), GRID, {"road": one, "wind": one})["x"]
    np.testing.assert_allclose(found, 1.0 + 2.0 * np.linspace(0.0, 1.0, 21), rtol=1e-13)


class Driven(al.System):
    """`x' = gain u`, with a signal of its own beside the input."""

    states = ("x",)
    gain: al.Number = 1.0
    own: al.AbstractSignal | None = None

    def rhs(self, t, z, u, shift=0.0):
        return (self.gain * u + shift,)

    def outputs(self, t, z):
        return {"x": z.x}

    def signals(self):
        return {} if self.own is None else {"shift": self.own}


LONG = al.Grid(3.0, 6)
RAMP, SHORT = (al.Tabulated([0.0, end], [0.0, 1.0]) for end in (3.0, 1.0))
UNIFORM = al.Uniform(1.0, half_width=0.1)


@pytest.mark.parametrize(
    ("system", "grid", "inputs", "message"),
    [
        (Named(), GRID, {"raod": RAMP}, r"Named takes the inputs \['road'\]; received \['raod'\]"),
        (Driven(), LONG, {"u": SHORT}, r"Input 'u' is known from 0 to 1 s, but the grid runs from 0 to 3 s\. Give"),
        (Driven(UNIFORM), LONG, {"u": RAMP}, r"with plain numbers.*'system\.gain' is a Uniform\. .*al\.expand or"),
        (Decay(1.0), None, None, r"Decay evolves in time: expected a grid, such as al\.Grid"),
    ],
)
def test_simulating_what_is_not_known_or_does_not_reach_is_refused_in_words(system, grid, inputs, message):
    with pytest.raises(al.ProblemError, match=message):
        al.simulate(system, grid, inputs)


def test_an_output_that_there_is_not_is_refused():
    with pytest.raises(al.ProblemError, match=r"expected in `only` a list"):
        al.simulate(Decay(1.0), GRID, only=["y"])


def test_traced_numbers_pass_and_the_signals_that_are_known_are_checked_while_others_are_traced():
    def final(gain, u):
        return al.simulate(Driven(gain), LONG, {"u": u})["x"][-1]

    # the integral of a ramp to 1 over 3 s
    np.testing.assert_allclose(compiled(jax.jacfwd(final))(2.0, RAMP), 1.5, rtol=1e-12)
    with pytest.raises(al.ProblemError, match="Input 'u' is known from 0 to 1 s"):
        compiled(lambda gain: final(gain, SHORT))(2.0)
