"""Limits on skewness and kurtosis: certified where the expansion has them, against closed forms and SciPy."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import aleator as al
from zoo import algebraic, cases

Exponential = algebraic(lambda c, x: {"g": jnp.exp(c * x), "c": c})


def solved(c, x, limit, order, sign):
    """The design of the largest `sign * c` that meets a limit."""
    parts = {"minimize": -sign * al.output("c").mean, "subject_to": [limit], "expansion": al.Expansion(order)}
    return al.solve(al.Problem(Exponential(c, x), **parts), throw=False)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("limit", "of", "sign"),
    cases(
        [
            (al.output("g").skewness >= 0.4, scipy.stats.skew, 1),
            (al.output("g").skewness <= 0.5, scipy.stats.skew, -1),
            (al.output("g").kurtosis >= 3.5, lambda values: scipy.stats.kurtosis(values, fisher=False), 1),
        ]
    ),
    ids=["lower", "upper", "kurtosis"],
)
def test_a_shape_that_polynomials_owe_to_what_never_occurs_is_no_answer(limit, of, sign):
    solution = solved(al.Decision(-0.5, -1.5, -0.05), al.Gamma(shape=0.6, scale=2.0), limit, 8, sign)
    values = np.exp(solution.decisions["c"] * scipy.stats.gamma(0.6, scale=2.0).ppf((np.arange(10**5) + 0.5) / 10**5))
    value = float(solution.constraints[0].values[0])
    assert abs(of(values) - value) > 0.4
    assert not solution.ok
    opinion = solution.certificate.opinion
    assert opinion is not None
    by = float(opinion.broken.split(" by ")[-1].split(" ± ")[0])
    assert by == pytest.approx(of(values) - value, rel=0.05)


@pytest.mark.parametrize(
    ("limit", "bound", "of"),
    cases(
        [
            (al.output("g").skewness <= 1.0, 1.0, "s"),
            (al.output("g").kurtosis <= 30.0, 27.0, "k"),  # SciPy tells the excess over 3
        ]
    ),
    ids=["skewness", "kurtosis"],
)
def test_a_shape_that_the_expansion_has_is_confirmed_though_its_tail_is_heavy(limit, bound, of):
    solution = solved(al.Decision(0.1, 0.05, 1.5), al.Normal(0.0, 1.0), limit, 10, 1)
    true = scipy.stats.lognorm(solution.decisions["c"]).stats(of)
    assert solution.ok
    assert float(true) == pytest.approx(bound, rel=1e-4)
