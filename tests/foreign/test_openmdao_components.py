"""Problems as components of OpenMDAO: partials by its own check, optima of its drivers, a place in a larger model."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import openmdao.api as om
import pytest
from openmdao.utils.assert_utils import assert_check_partials

import aleator as al
from aleator.foreign import _openmdao
from aleator.foreign._openmdao_units import as_in_openmdao
from zoo import Decay

# Instants and constraints that some decisions do not move are as they should be.
pytestmark = pytest.mark.filterwarnings("ignore::openmdao.utils.om_warnings.DerivativesWarning")


class Truss(al.AlgebraicSystem):
    """Two bars of different areas under one uncertain load: their stresses and their volume."""

    areas: al.Number
    load: al.Number
    length: al.Number = 1.5

    def outputs(self):
        stress = self.load / self.areas
        return {"first": stress[0], "second": 1.5 * stress[1], "volume": self.length * jnp.sum(self.areas)}


def truss():
    first, second, volume = (al.output(name) for name in ("first", "second", "volume"))
    return al.Problem(
        Truss(
            areas=al.Decision(np.array([2.0, 3.0]), 0.1, 10.0),
            load=al.Uniform(al.Decision(4.0, 3.0), half_width=0.4),
            length=1.5,
        ),
        minimize=volume.mean - al.value("load.mean"),
        subject_to=[
            first.at_most(2.0, sigmas=1.0),
            second.at_most(2.5, sigmas=1.0),
            (al.value("load.mean") <= 5.0).named("load (most)"),
        ],
        expansion=al.Expansion(order=2),
    )


def built(problem, **settings):
    """A model of OpenMDAO with the problem alone, ready to run, and its component."""
    component = al.foreign.openmdao_component(problem, **settings)
    model = om.Problem(reports=None)
    model.model.add_subsystem("design", component, promotes=["*"])
    return model, component


def run(model):
    model.setup()
    model.run_model()
    return model


@pytest.fixture(scope="module")
def found():
    """OpenMDAO's optimum of the truss."""
    model, _ = built(truss())
    model.driver = om.ScipyOptimizeDriver(optimizer="SLSQP", tol=1e-12, disp=False)
    run(model)
    result = model.run_driver()
    assert result.success
    return model


def test_partials_hold_in_the_check_of_openmdao_where_a_complex_step_is_refused_with_what_to_do():
    model, _ = built(truss())
    model.setup(force_alloc_complex=True)
    model.run_model()
    said = r"'design' expected real inputs; received complex ones, of a complex step.*check_partials\(method='fd'\)"
    with pytest.raises(al.ProblemError, match=said):
        model.check_partials(out_stream=None, method="cs")
    checked = model.check_partials(out_stream=None, form="central", step=1e-6)
    assert {of for of, _ in checked["design"]} == {"objective", "first", "second", "load_most"}
    assert_check_partials(checked, atol=1e-8, rtol=1e-8)


def test_partials_of_limits_along_time_hold_too():
    decay = Decay(rate=al.Uniform(al.Decision(2.0, 1.0, 5.0), half_width=0.1), start=al.Decision(1.0, 0.5, 2.0))
    x = al.path("x")
    problem = al.Problem(
        decay,
        grid=al.Grid(1.0, 8),
        minimize=al.terminal("x").mean,
        subject_to=[x.within(0.1, 3.0, sigmas=1.0)],
        expansion=al.Expansion(order=1),
    )
    model, component = built(problem)
    checked = run(model).check_partials(out_stream=None, form="central", step=1e-6)
    assert model.get_val("x").shape == (9,)
    assert {wrt for _, wrt in checked["design"]} == {"rate:mean", "start"}
    assert_check_partials(checked, atol=1e-8, rtol=1e-8)
    assert len(component.list_outputs(out_stream=None)) == 3


def test_the_optimum_of_openmdao_is_ours_and_keeps_each_limit(found):
    ours = al.solve(truss())
    assert found.get_val("objective") == pytest.approx(ours.objective, rel=1e-7)
    np.testing.assert_allclose(found.get_val("areas"), ours.decisions["areas"], rtol=1e-6)
    assert found.get_val("load:mean") == pytest.approx(ours.decisions["load.mean"], rel=1e-6)
    # The areas carry the mean load and one standard deviation of it, which is 0.4 / √3.
    most = found.get_val("load:mean").item() + 0.4 / np.sqrt(3)
    np.testing.assert_allclose(found.get_val("areas"), [most / 2.0, 1.5 * most / 2.5], rtol=1e-6)


def test_a_component_in_a_larger_model_passes_derivatives_on():
    model, _ = built(truss(), declared=False)
    model.model.add_subsystem("before", om.ExecComp("load = 2 * mass"), promotes_inputs=["mass"])
    model.model.connect("before.load", "load:mean")
    model.model.add_subsystem("after", om.ExecComp("cost = total ** 2"), promotes_outputs=["cost"])
    model.model.connect("objective", "after.total")
    model.model.set_order(["before", "design", "after"])
    model.model.set_input_defaults("mass", 2.2)
    run(model)
    objective = 1.5 * (2.0 + 3.0) - 4.4
    assert model.get_val("cost") == pytest.approx(objective**2)
    total = model.compute_totals(of=["cost"], wrt=["mass", "areas"], return_format="flat_dict")
    np.testing.assert_allclose(total["cost", "mass"], [[2 * objective * -1.0 * 2.0]], rtol=1e-12)
    np.testing.assert_allclose(total["cost", "areas"], [[2 * objective * 1.5] * 2], rtol=1e-12)


def test_names_are_those_that_openmdao_allows_and_each_is_used_once():
    given = ["k.half_width", "x(t_f)", "x(t)", "x(t_f)", "objective", "2nd", "?"]
    expected = ["k:half_width", "x_t_f", "x_t", "x_t_f_2", "objective_2", "of_2nd", "constraint"]
    assert _openmdao._names(given) == expected


class Plate(al.AlgebraicSystem):
    """The sag of a plate under an uncertain pressure, in declared units."""

    units: ClassVar = {"sag": "mm", "mass": "kg"}
    thickness: al.Number = al.parameter("mm")
    pressure: al.Number = al.parameter("N/m²")
    price: al.Number = al.parameter("EUR/kg")

    def outputs(self):
        return {"sag": 1e-3 * self.pressure / self.thickness**3, "mass": 0.5 * self.thickness, "pays": self.price}


def test_declared_units_are_those_of_inputs_and_outputs():
    sag, mass = al.output("sag"), al.output("mass")
    plate = Plate(
        thickness=al.Decision(20.0, 5.0, 50.0),
        pressure=al.Normal(al.Decision(4e3, 1e3, 9e3), 100.0),
        price=al.Decision(2.0, 1.0, 3.0),
    )
    problem = al.Problem(
        plate,
        minimize=sag.mean + 2.0 * sag.std,
        subject_to=[mass.at_most(30.0), (al.output("pays").mean >= 1.0).named("pays")],
        expansion=al.Expansion(order=1),
    )
    model, component = built(problem)
    model.setup()
    model.set_val("thickness", 0.02, units="m")
    model.set_val("pressure:mean", 5.0, units="kPa")
    model.run_model()
    listed = component.list_vars(units=True, out_stream=None)
    found = {name.removeprefix("design."): one["units"] for name, one in listed}
    assert found == {
        "thickness": "mm",
        "pressure:mean": "N/m**2",
        "price": None,
        "objective": "mm",
        "mass": "kg",
        "pays": None,
    }
    sag_of = 1e-3 * (5e3 + 2 * 100.0) / 20.0**3
    np.testing.assert_allclose(model.get_val("objective", units="m"), 1e-3 * sag_of)
    np.testing.assert_allclose(model.get_val("mass", units="g"), 1e4)


@pytest.mark.parametrize(
    ("unit", "there"),
    [
        ("m²/s⁴", "m**2/s**4"),
        ("N m", "N*m"),
        ("kg m^2 s^-2", "kg*m**2*s**-2"),
        ("J/(kg K)", "J/(kg*K)"),
        ("°", "deg"),
        ("N m/rad", "N*m/rad"),
        ("°C", None),
        ("W/m² K", None),
        ("g", None),
        ("", None),
        ("bananas", None),
    ],
)
def test_units_are_spelt_as_in_openmdao_or_there_is_none(unit, there):
    assert as_in_openmdao(unit) == there


def test_limits_on_single_realisations_are_refused():
    problem = al.Problem(
        Truss(areas=al.Decision(np.array([2.0, 3.0]), 0.1, 10.0), load=al.Uniform(4.0, half_width=0.4)),
        minimize=al.output("volume").mean,
        subject_to=[al.output("first").at_most(2.0, worst_case=True)],
    )
    with pytest.raises(al.ProblemError, match="received 'first' on single realisations"):
        al.foreign.openmdao_component(problem)


def test_a_model_without_finite_values_lets_the_driver_step_back():
    model, _ = built(truss())
    run(model)
    model.set_val("areas", [0.0, 1.0])
    with pytest.raises(om.AnalysisError, match="no finite values or derivatives at"):
        model.run_model()
