"""Sobol indices from coefficients: Ishigami's function, chaospy, sums to one."""

import chaospy
import jax.numpy as jnp
import numpy as np
import pytest
from small_expansions import basis_of, coefficients_of_polynomial, random_coefficients

from aleator._core.errors import ProblemError
from aleator.expansion import Expansion, collocate
from aleator.statistics import Sobol, TotalSobol, prepare
from aleator.uncertainty import HermiteGerm, LegendreGerm
from compiling import compiled

of = compiled(lambda statistic, coefficients, constants: statistic.of(coefficients, constants))


def value(statistic, coefficients, basis):
    return np.asarray(of(statistic, coefficients, prepare([statistic], basis).of(statistic)))


@pytest.fixture(scope="module")
def ishigami():
    """Published indices of sin x1 + 7 sin^2 x2 + 0.1 x3^4 sin x1, uniform between -pi and pi."""
    germs = {"x1": LegendreGerm(), "x2": LegendreGerm(), "x3": LegendreGerm()}
    basis, collocation = collocate(germs, Expansion(14))
    x1, x2, x3 = np.pi * np.asarray(collocation.points).T
    samples = np.sin(x1) + 7 * np.sin(x2) ** 2 + 0.1 * x3**4 * np.sin(x1)
    return collocation.coefficients(jnp.asarray(samples)), basis


INDICES = {
    Sobol("x1"): 0.3139051912,
    Sobol(("x2",)): 0.4424111448,
    Sobol("x3"): 0.0,
    Sobol(("x3", "x1")): 0.2436836641,
    Sobol(("x1", "x2")): 0.0,
    Sobol(("x1", "x2", "x3")): 0.0,
    TotalSobol("x1"): 0.3139051912 + 0.2436836641,
    TotalSobol("x2"): 0.4424111448,
    TotalSobol("x3"): 0.2436836641,
}


@pytest.mark.parametrize("index", INDICES, ids=lambda index: index.text("y"))
def test_indices_of_ishigamis_function_are_the_published_ones(ishigami, index):
    assert value(index, *ishigami) == pytest.approx(INDICES[index], abs=1e-6)


def test_first_order_and_total_indices_agree_with_chaospys():
    basis = basis_of([LegendreGerm(), HermiteGerm()], 3)
    joint = chaospy.J(chaospy.Uniform(-1, 1), chaospy.Normal(0, 1))
    a, b = chaospy.variable(2)
    theirs = a + a * b + 0.5 * b**2 + 0.2 * a**2 * b
    coefficients = coefficients_of_polynomial(basis, lambda a, b: a + a * b + 0.5 * b**2 + 0.2 * a**2 * b)
    first, total = chaospy.Sens_m(theirs, joint), chaospy.Sens_t(theirs, joint)
    for i, name in enumerate("ab"):
        assert value(Sobol(name), coefficients, basis) == pytest.approx(first[i], rel=1e-8)
        assert value(TotalSobol(name), coefficients, basis) == pytest.approx(total[i], rel=1e-8)


def test_the_indices_of_all_sets_of_variables_add_up_to_one_entry_by_entry():
    basis = basis_of([LegendreGerm(), HermiteGerm(), LegendreGerm()], 3)
    path = random_coefficients(basis, shape=(5,))
    sets = ["a", "b", "c", ("a", "b"), ("a", "c"), ("b", "c"), ("a", "b", "c")]
    assert sum(value(Sobol(one), path, basis) for one in sets) == pytest.approx(np.ones(5), rel=1e-13)


def test_an_output_that_does_not_vary_has_zero_indices():
    basis = basis_of([LegendreGerm()], 2)
    assert value(Sobol("a"), jnp.array([3.0, 0.0, 0.0]), basis) == 0.0


def test_an_unknown_variable_is_refused_with_close_matches():
    basis = collocate({"mass": LegendreGerm(), "damping": HermiteGerm()}, Expansion(2)).basis
    for index in (Sobol("mas"), Sobol(("damping", "mas")), TotalSobol("mas")):
        with pytest.raises(ProblemError, match=r"no germ variable 'mas'\. Did you mean 'mass'"):
            prepare([index], basis)
    with pytest.raises(ProblemError, match=r"Expected one of \['mass', 'damping'\]"):
        prepare([Sobol("q")], basis)


@pytest.mark.parametrize("names", [(), ("a", "a"), (1,)])
def test_a_set_of_variables_that_is_none_is_refused(names):
    with pytest.raises(ProblemError, match="one name or several different ones"):
        Sobol(names)


def test_an_index_from_one_sample_is_refused():
    for index in (Sobol("a"), TotalSobol("a")):
        with pytest.raises(ProblemError, match="from one sample"):
            index.of_sample(jnp.zeros((5,)))


def test_statistics_that_need_the_same_constants_share_them():
    basis = basis_of([LegendreGerm(), HermiteGerm()], 2)
    constants = prepare([Sobol("a"), Sobol(("a",)), TotalSobol("a")], basis)
    assert len(constants.values) == 2
    assert constants.of(Sobol("a")) is constants.of(Sobol(("a",)))
