"""One result of each type, solved once or made of results that are: what figures and tables are drawn of."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import report_problems as given

import aleator as al

MEAN = al.integral("effort").mean
STD = al.integral("effort").std


@cache
def expanded() -> al.results.Expanded:
    """Of two outputs: `3 u + r` with normal inputs of standard deviations 1 and 2, and three multiples of `u`."""
    distributions = {"u": al.Normal(1.0, 1.0), "r": al.Normal(0.0, 2.0)}
    return al.expand(
        lambda at: {"sum <b>&": 3 * at["u"] + at["r"], "many": at["u"] * jnp.arange(1.0, 4.0)},
        distributions,
        al.Expansion(order=1),
    )


@cache
def tolerances() -> al.results.ToleranceAnalysis:
    parts = {"housing": al.Toleranced(10.0, tolerance=0.18), "plate": al.Toleranced(4.0, tolerance=0.12)}
    gap = al.Assembly(dimensions=parts, features={"gap": "housing - 2*plate"})
    return al.tolerance_analysis(gap, "gap", lower=1.8, upper=2.2)


def trade_off(wishes: int) -> al.results.TradeOff:
    """Three designs, of which the values are made up."""
    names = ("effort", "spread <b>&", "reach", "cost")[:wishes]
    values = np.array([[1.0, 9.0, 4.0, 2.0], [2.0, 6.0, 5.0, 1.0], [4.0, 1.0, 6.0, 3.0]])[:, :wishes]
    wish = (MEAN, STD, al.terminal("back").mean, MEAN)[:wishes]
    ends = values.min(axis=0), values.max(axis=0)
    return al.results.TradeOff(names, wish, values, (given.solution(),) * 3, *ends, np.ones_like(values))


def starts() -> al.results.Starts:
    return al.results.Starts((given.solution(), given.infeasible(), given.front().solutions[0]))


def portfolio(optima: int = 2) -> al.results.Portfolio:
    found = [al.results.Optimum(15.5 + i, {"c.mean": 1.9 + i}, 6 - i, 4 - i) for i in range(optima)]
    return al.results.Portfolio(given.solution(), tuple(found), 12, 8, 8, searched())


def searched() -> al.results.Searched:
    objectives, violations = np.array([5.0, 3.0, 2.0, 4.0]), np.array([0.0, 0.0, 0.5, 0.0])
    return al.results.Searched("search <b>&", objectives, violations, "done", 0.1)


def evidence_of_all() -> al.results.EvidenceOfAll:
    """Of two designs, of which the second could not be simulated."""
    found = (given.evidence(), None)
    return al.results.EvidenceOfAll((given.solution(),) * 2, ("a <b>&", "b"), found, {1: "it <i>broke</i>"})


def hardened() -> al.results.Hardened:
    solutions, excesses = (given.solution(),) * 3, ({"reach": 0.2}, {"reach": 0.02}, {"reach": 0.0})
    return al.results.Hardened(solutions, (1.0, 10.0, 100.0), excesses, 1e-4)


def cross_checked() -> al.results.CrossChecked:
    return al.results.CrossChecked(
        *(given.solution(), given.collocated(), ("shooting", "collocation"), 1e-6),
        *({"c.mean": 2e-7}, {"μ[∫effort dt]": 3e-6}, {"reach <b>&": float("inf")}, 1e-4),
    )


EVERY = {
    "solution": given.solution,
    "failed solution": given.infeasible,
    "solution by collocation": given.collocated,
    "evidence": given.evidence,
    "front": given.front,
    "calibration": given.calibration,
    "expanded function": expanded,
    "tolerance analysis": tolerances,
    "trade-off of two": lambda: trade_off(2),
    "trade-off of three": lambda: trade_off(3),
    "trade-off of four": lambda: trade_off(4),
    "starts": starts,
    "portfolio": portfolio,
    "search": searched,
    "evidence of all": evidence_of_all,
    "penalties": hardened,
    "cross-check": cross_checked,
    "states": lambda: given.collocated().mesh_states,
    "costates": lambda: given.collocated().costates,
    "switching functions": lambda: given.collocated().switching,
    "mesh": lambda: given.collocated().mesh,
}
