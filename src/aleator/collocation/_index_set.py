"""Index sets: which products of univariate polynomials make the multivariate basis (equation 16)."""

import itertools
from math import comb

import numpy as np
from jaxtyping import Int


def total_degree(variables: int, order: int) -> Int[np.ndarray, "terms variables"]:
    """All multi-indices of total degree at most `order`, by degree; the first is the constant.

    There are `(variables + order)! / (variables! order!)` of them.
    """
    rows = [
        np.bincount(np.array(chosen, dtype=int), minlength=variables)[:variables]
        for degree in range(order + 1)
        for chosen in itertools.combinations_with_replacement(range(variables), degree)
    ]
    return np.array(rows, dtype=int).reshape(comb(variables + order, order) if variables else 1, variables)
