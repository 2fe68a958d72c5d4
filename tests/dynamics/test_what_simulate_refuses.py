import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.uncertainty import at_means
from compiling import compiled


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


class Gap(al.AlgebraicSystem):
    width: al.Number = 1.0

    def outputs(self):
        return {"gap": 2 * self.width}


GRID = al.Grid(3.0, 6)
RAMP, SHORT = (al.Tabulated([0.0, end], [0.0, 1.0]) for end in (3.0, 1.0))
DISTRIBUTION, DECISION = al.Uniform(1.0, half_width=0.1), al.Decision(1.0, 0.0, 2.0)


@pytest.mark.parametrize(
    ("system", "grid", "u", "message"),
    [
        (Driven(), GRID, SHORT, r"Input 'u' is known from 0 to 1 s, but the grid runs from 0 to 3 s\. Give it for"),
        (Driven(), GRID, al.Tabulated([0.5, 3.0], [0.0, 1.0]), "is known from 0.5 to 3 s, but the grid runs from 0 to"),
        (
            Driven(own=SHORT),
            GRID,
            RAMP,
            "Signal 'shift' of Driven is known from 0 to 1 s, but the grid runs from 0 to 3",
        ),
        (Driven(), GRID, 1.0, r"Input 'u' must be a signal, such as al\.Tabulated\(times, values\); received float"),
        (Driven(DISTRIBUTION), GRID, RAMP, r"with plain numbers.*'system\.gain' is a Uniform\. .*al\.expand or"),
        (Driven(DECISION), GRID, RAMP, r"'system\.gain' is a Decision"),
        (at_means(Driven(DISTRIBUTION)), GRID, RAMP, r"'system\.gain' is a AtMean"),
        (Driven(), al.Grid(al.Decision(2.0, 1.0, 3.0), 6), RAMP, r"'grid\.t_final' is a Decision"),
        (Driven(), GRID, al.Tabulated([0.0, 3.0], [0.0, DISTRIBUTION]), r"'inputs\.u\.values\.1' is a Uniform"),
        (
            Driven(DISTRIBUTION),
            GRID,
            al.BSpline(al.Decision(np.ones(4))),
            r"'inputs\.u\.free' is a Decision.*'system\.gain' is",
        ),
    ],
)
def test_simulating_what_is_not_known_or_does_not_reach_is_refused_in_words(system, grid, u, message):
    with pytest.raises(al.ProblemError, match=message):
        al.simulate(system, grid, {"u": u})


def test_distributions_left_in_an_algebraic_system_are_refused():
    with pytest.raises(al.ProblemError, match=r"'system\.width' is a Uniform"):
        al.simulate(Gap(DISTRIBUTION))


def test_traced_numbers_pass_and_the_signals_that_are_known_are_checked_while_others_are_traced():
    def final(gain, u):
        return al.simulate(Driven(gain), GRID, {"u": u})["x"][-1]

    # the integral of a ramp to 1 over 3 s
    np.testing.assert_allclose(compiled(jax.jacfwd(final))(2.0, RAMP), 1.5, rtol=1e-12)
    known = al.Tabulated([0.0, 1.0], [0.0, 1.0])
    with pytest.raises(al.ProblemError, match="Input 'u' is known from 0 to 1 s"):
        compiled(lambda gain: final(gain, known))(2.0)
    arrays = jax.tree.map(jnp.asarray, known)
    with pytest.raises(al.ProblemError, match="Input 'u' is known from 0 to 1 s"):
        compiled(lambda gain: final(gain, arrays))(2.0)
