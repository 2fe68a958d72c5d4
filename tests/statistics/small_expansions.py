"""Bases and coefficients that the tests of statistics share."""

import numpy as np

from aleator._core.arrays import jax_array
from aleator.expansion import Basis, TotalDegree
from aleator.statistics import Constants


def prepare(statistics, basis):
    """The constants of all statistics, as problems have them."""
    preparations = tuple(dict.fromkeys(one.preparation for one in statistics if one.preparation is not None))
    return Constants(preparations, tuple(preparation(basis) for preparation in preparations))


def basis_of(germs, order):
    """Total degree, in variables a, b, c, ..."""
    names = tuple("abcdefghij"[: len(germs)])
    return Basis(dict(zip(names, germs, strict=True)), TotalDegree().indices(names, order))


def coefficients_of_polynomial(basis, function, points=400):
    """Exact for polynomials in the span of the basis: least squares at random points."""
    germ = basis.map_to_germ(np.random.default_rng(0).uniform(0.01, 0.99, (points, basis.variables)))
    return jax_array(np.linalg.lstsq(basis.matrix(germ), function(*germ.T), rcond=None)[0])


def random_coefficients(basis, seed=0, shape=(), decay=0.3):
    """Coefficients that fall with the degree; the linear part of the first variable is large."""
    generator = np.random.default_rng(seed)
    degrees = basis.indices.sum(axis=1).reshape(-1, *[1] * len(shape))
    coefficients = generator.normal(size=(basis.terms, *shape)) * decay**degrees
    coefficients[1] += 1.0
    return jax_array(coefficients)
