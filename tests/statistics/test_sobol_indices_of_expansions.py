"""Sobol indices from coefficients: Ishigami's function, chaospy, sums to one."""

import jax.numpy as jnp
import numpy as np
import pytest
from small_expansions import basis_of, prepare, random_coefficients

from aleator._core.errors import ProblemError
from aleator.expansion import Expansion, collocate
from aleator.statistics import Sobol
from aleator.uncertainty import HermiteGerm, LegendreGerm


def value(statistic, coefficients, basis):
    return np.asarray(statistic.of(np.asarray(coefficients), prepare([statistic], basis).of(statistic)))


def ishigami():
    """`sin x1 + 7 sin^2 x2 + 0.1 x3^4 sin x1`, uniform between -pi and pi."""
    germs = {"x1": LegendreGerm(), "x2": LegendreGerm(), "x3": LegendreGerm()}
    basis, collocation = collocate(germs, Expansion(14))
    x1, x2, x3 = np.pi * np.asarray(collocation.points).T
    samples = np.sin(x1) + 7 * np.sin(x2) ** 2 + 0.1 * x3**4 * np.sin(x1)
    return collocation.coefficients(samples), basis


INDICES = {
    Sobol("x1"): 0.3139051912,
    Sobol(("x2",)): 0.4424111448,
    Sobol("x3"): 0.0,
    Sobol(("x3", "x1")): 0.2436836641,
    Sobol(("x1", "x2")): 0.0,
    Sobol(("x1", "x2", "x3")): 0.0,
    Sobol("x1", total=True): 0.3139051912 + 0.2436836641,
    Sobol("x2", total=True): 0.4424111448,
    Sobol("x3", total=True): 0.2436836641,
}


def test_indices_of_ishigamis_function_are_the_published_ones():
    coefficients, basis = ishigami()
    for index, published in INDICES.items():
        assert value(index, coefficients, basis) == pytest.approx(published, abs=1e-6), index


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
    for index in (Sobol(("damping", "mas")), Sobol("mas", total=True)):
        with pytest.raises(ProblemError, match=r"no germ variable 'mas'\. Did you mean 'mass'"):
            prepare([index], basis)
