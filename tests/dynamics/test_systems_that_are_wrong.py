import jax.numpy as jnp
import numpy as np
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
            return {} if initial is None else initial

    return Model()


@pytest.mark.parametrize(
    "integrator", [al.integrators.RungeKutta4(), al.integrators.Tsit5()], ids=["RungeKutta4", "Tsit5"]
)
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"rhs": lambda z: (z.v,)}, r"Model\.rhs: expected 2 rates, for \('x', 'v'\); received 1"),
        ({"rhs": lambda z: (z.v, z.x, z.x)}, "expected 2 rates.*received 3"),
        ({"rhs": lambda z: jnp.stack([z.v, z.x])}, "returns one rate for each of .* as a tuple; received"),
        ({"rhs": lambda z: None}, "as a tuple; received None"),
        ({"rhs": lambda z: (z.v * jnp.ones(3), z.x)}, r"expected a rate of shape \(\) for 'x'; received \(3,\)"),
        ({"initial": {"y": 1.0}}, r"initial names \['y'\], which are not states; expected some of \('x', 'v'\)"),
        ({"initial": [1.0, 2.0]}, r"Model\.initial returns a dict of initial values by state; received list \[1.0"),
        (
            {"rhs": lambda z: (jnp.ones(3), z.x)},
            r"expected a rate of shape \(\) for 'x'; received \(3,\)\. If 'x' is an array, give its initial value in",
        ),
        (
            {"rhs": lambda z: (z.v if z.x > 0 else 0.0, z.x)},
            r"Model\.rhs branches on a number that is only known at run time: use jnp\.where\(condition, a, b\)",
        ),
        ({"outputs": lambda z: {"x": max(z.x, 0.0)}}, r"Model\.outputs branches on a number"),
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
    np.testing.assert_allclose(outputs["x"], [0.0, 0.5, 1.0], rtol=1e-15)
    assert outputs["one"].tolist() == [1.0, 1.0, 1.0]


class Named(al.System):
    states = ("x",)

    def rhs(self, t, z, road, **others):
        return (road + others.get("wind", 0.0),)

    def outputs(self, t, z):
        return {"x": z.x}


class Observed(al.System):
    states = ("x",)

    def rhs(self, t, z):
        return (1.0,)

    def outputs(self, t, z, *, road=0.0):
        return {"x": z.x + road}


ONE = al.Tabulated(np.array([0.0, 1.0]), np.ones(2))


@pytest.mark.parametrize(
    "integrator", [al.integrators.RungeKutta4(), al.integrators.Tsit5()], ids=["RungeKutta4", "Tsit5"]
)
@pytest.mark.parametrize(
    ("model", "inputs", "end"),
    [
        (Named(), {"road": ONE}, 1.0),
        (Named(), {"road": ONE, "wind": ONE}, 2.0),
        (Observed(), {"road": ONE}, 2.0),
        (Observed(), {}, 1.0),
    ],
)
def test_each_method_is_given_the_inputs_that_it_names_and_no_others(model, inputs, end, integrator):
    assert float(al.simulate(model, GRID, inputs, integrator)["x"][-1]) == pytest.approx(end, rel=1e-7)


@pytest.mark.parametrize(
    ("model", "inputs", "message"),
    [
        (Named(), {}, r"Named takes the inputs \['road'\]; received \[\]"),
        (Named(), {"wind": ONE}, r"Named takes the inputs \['road'\]; received \['wind'\]"),
        (Observed(), {"raod": ONE}, r"Observed takes the inputs \['road'\]; received \['raod'\]"),
    ],
)
def test_an_input_that_is_missing_or_misspelt_is_refused(model, inputs, message):
    with pytest.raises(al.ProblemError, match=message):
        al.simulate(model, GRID, inputs)


def test_initial_values_that_are_no_method_are_refused():
    class Model(al.System):
        states = ("x",)
        initial = {"x": 1.0}  # noqa: RUF012

        def rhs(self, t, z):
            return (-z.x,)

        def outputs(self, t, z):
            return {"x": z.x}

    with pytest.raises(
        al.ProblemError, match=r"Model\.initial: expected a method that returns values by state; received"
    ):
        al.simulate(Model(), GRID)
