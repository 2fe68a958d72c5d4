import jax.numpy as jnp
import pytest

import aleator as al

GRID = al.Grid(1.0, 2)


def system(rhs=lambda z: (z.v, -z.x), outputs=lambda z: {"x": z.x}, initial=None):
    class Model(al.System):
        states = ("x", "v")

        def rhs(self, t, z):
            return rhs(z)

        def outputs(self, t, z):
            return outputs(z)

        def initial(self):
            return initial or {}

    return Model()


@pytest.mark.parametrize("integrator", [al.RungeKutta4(), al.Tsit5()], ids=["RungeKutta4", "Tsit5"])
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"rhs": lambda z: (z.v,)}, r"Model\.rhs: expected 2 rates, for \('x', 'v'\); received 1"),
        ({"rhs": lambda z: (z.v, z.x, z.x)}, "expected 2 rates.*received 3"),
        ({"rhs": lambda z: jnp.stack([z.v, z.x])}, "returns one rate for each of .* as a tuple; received"),
        ({"rhs": lambda z: None}, "as a tuple; received None"),
        ({"rhs": lambda z: (z.v * jnp.ones(3), z.x)}, r"expected a rate of shape \(\) for 'x'; received \(3,\)"),
        ({"initial": {"y": 1.0}}, r"initial names \['y'\], which are no states; expected some of \('x', 'v'\)"),
        ({"outputs": lambda z: z.x}, "outputs returns a dict of arrays by name; received"),
        ({"outputs": lambda z: [z.x]}, "received list"),
    ],
)
def test_a_system_that_does_not_fit_together_is_refused_in_words(wrong, message, integrator):
    with pytest.raises(al.ProblemError, match=message):
        al.simulate(system(**wrong), GRID, integrator=integrator)


def test_a_wrong_system_is_refused_when_the_problem_is_declared():
    with pytest.raises(al.ProblemError, match="expected 2 rates"):
        al.Problem(system(rhs=lambda z: (z.v,)), grid=GRID, minimize=al.rms("x").mean)


def test_rates_and_outputs_may_be_whole_numbers():
    outputs = al.simulate(system(rhs=lambda z: (1, 0), outputs=lambda z: {"x": z.x, "one": 1}), GRID)
    assert outputs["x"].tolist() == [0.0, 0.5, 1.0]
    assert outputs["one"].tolist() == [1.0, 1.0, 1.0]
