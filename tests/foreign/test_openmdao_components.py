"""Problems as components of OpenMDAO: partials by its own check, optima of its drivers, a place in a larger model."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import openmdao.api as om
import pytest
from openmdao.utils.assert_utils import assert_check_partials

import aleator as al
from aleator.foreign._openmdao import as_in_openmdao

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


def test_the_optimum_of_openmdao_keeps_each_limit():
    model, _ = built(truss())
    model.driver = om.ScipyOptimizeDriver(optimizer="SLSQP", tol=1e-12, disp=False)
    run(model)
    assert model.run_driver().success
    # A load of one more costs 1.5 (1 / 2 + 1.5 / 2.5) of volume: it is as small as it may be. The areas carry its mean
    # and one standard deviation, which is 0.4 / √3.
    assert model.get_val("load:mean") == pytest.approx(3.0, rel=1e-6)
    most = 3.0 + 0.4 / np.sqrt(3)
    np.testing.assert_allclose(model.get_val("areas"), [most / 2.0, 1.5 * most / 2.5], rtol=1e-6)


class Plate(al.AlgebraicSystem):
    """The sag of a plate under an uncertain pressure, in declared units."""

    units: ClassVar = {"sag": "mm", "mass": "kg"}
    thickness: al.Number = al.parameter("mm")
    pressure: al.Number = al.parameter("N/m²")

    def outputs(self):
        return {"sag": 1e-3 * self.pressure / self.thickness**3, "mass": 0.5 * self.thickness}


def test_declared_units_are_those_of_inputs_and_outputs():
    sag, mass = al.output("sag"), al.output("mass")
    plate = Plate(al.Decision(20.0, 5.0, 50.0), al.Normal(al.Decision(4e3, 1e3, 9e3), 100.0))
    problem = al.Problem(
        plate,
        minimize=sag.mean + 2.0 * sag.std,
        subject_to=[mass.at_most(30.0)],
        expansion=al.Expansion(order=1),
    )
    model, component = built(problem)
    model.setup()
    model.set_val("thickness", 0.02, units="m")
    model.set_val("pressure:mean", 5.0, units="kPa")
    model.run_model()
    listed = component.list_vars(units=True, out_stream=None)
    found = {name.removeprefix("design."): one["units"] for name, one in listed}
    assert found == {"thickness": "mm", "pressure:mean": "N/m**2", "objective": "mm", "mass": "kg"}
    sag_of = 1e-3 * (5e3 + 2 * 100.0) / 20.0**3
    np.testing.assert_allclose(model.get_val("objective", units="m"), 1e-3 * sag_of)
    np.testing.assert_allclose(model.get_val("mass", units="g"), 1e4)


def test_units_are_spelt_as_in_openmdao_or_there_is_none():
    spelt = {"m²/s⁴": "m**2/s**4", "J/(kg K)": "J/(kg*K)", "°": "deg", "°C": None, "bananas": None}
    assert {unit: as_in_openmdao(unit) for unit in spelt} == spelt
