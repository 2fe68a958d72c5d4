"""Designs whose realisations end at an event of their own, or are judged at one."""

from functools import cache
from typing import Any

import numpy as np
import pytest
import scipy

import aleator as al
from zoo import G, Shot


def landing(angle, c):
    """Where it lands, how high it was and how long it flew, by SciPy."""

    def rates(t, z):
        drag = c * np.hypot(z[2], z[3])
        return [z[2], z[3], -drag * z[2], -G - drag * z[3]]

    ground: Any = lambda t, z: z[1]  # noqa: E731
    ground.terminal, ground.direction = True, -1
    start = [0.0, 1.0, 20 * np.cos(angle), 20 * np.sin(angle)]
    events = [ground, lambda t, z: z[3]]
    found = scipy.integrate.solve_ivp(rates, (0, 10), start, "DOP853", events=events, rtol=1e-11, atol=1e-12)
    return np.array([found.y[0, -1], found.y_events[1][0][1], found.t[-1]])


LANDED = al.Grid(until="ground", at_most=10.0, steps=80)


def shot(angle=0.6):
    return Shot(angle=al.Decision(angle, 0.1, 1.5), c=al.Uniform(0.02, half_width=0.01), height=1.0)


def farthest():
    return al.Problem(
        shot(),
        grid=LANDED,
        minimize=al.terminal("x").std - al.terminal("x").mean,
        subject_to=[al.at("top", "y").mean <= 100.0, al.at("ground").mean <= 100.0, al.integral("vx").mean <= 100.0],
        expansion=al.Expansion(order=6),
    )


@cache
def solution():
    return al.solve(farthest())


@pytest.mark.slow
def test_the_angle_of_the_best_mean_less_spread_is_that_which_scipy_finds():
    nodes, weights = np.polynomial.legendre.leggauss(8)

    def moments(angle):
        values = np.array([landing(angle, 0.02 + 0.01 * node) for node in nodes])
        mean = weights @ values / 2
        return mean, np.sqrt(weights @ (values - mean) ** 2 / 2)

    def objective(angle):
        mean, std = moments(angle)
        return std[0] - mean[0]

    right = scipy.optimize.minimize_scalar(objective, bounds=(0.5, 0.9), method="bounded", options={"xatol": 1e-8}).x
    found = solution()
    assert found.decisions["angle"] == pytest.approx(right, abs=1e-6)
    mean, _ = moments(found.decisions["angle"])
    assert found.objective == pytest.approx(objective(found.decisions["angle"]), abs=1e-6)
    values = [found.statistics[f"μ[{one}]"] for one in ("y(t_top)", "t_ground", "∫vx dt")]
    assert values[:2] == pytest.approx(mean[1:], abs=1e-6)
    # The speed over the flight adds up to the distance, which the grid's own time ends.
    assert values[2] == pytest.approx(mean[0], abs=1e-6)


@pytest.mark.slow
def test_a_solution_tells_the_times_at_the_means_and_those_of_each_system():
    found = solution()
    assert found.instants[-1] == pytest.approx(landing(found.decisions["angle"], 0.02)[2], abs=1e-7)
    motion = found.outputs["time"]
    ends = motion["systems"].values[:, -1]
    assert ends == pytest.approx([landing(found.decisions["angle"], c)[2] for c in motion["c"].values], abs=1e-7)
    assert "80 steps to 'ground', at most 10 s" in str(found.problem)
    assert found.certificate.grid_error.is_met


def problem(system=None, grid=LANDED, minimize=None, **options):
    system = shot() if system is None else system
    return al.Problem(system, grid=grid, minimize=al.terminal("x").mean if minimize is None else minimize, **options)


def test_what_has_no_meaning_with_events_is_refused_where_it_is_declared():
    top = al.at("top", "y")
    for words, make in {
        "no event 'tip'.*Did you mean 'top'": lambda: problem(minimize=al.at("tip").mean),
        "each realisation ends at its own 'ground'": lambda: problem(minimize=al.time_integral(al.path("x").std)),
    }.items():
        with pytest.raises(al.ProblemError, match=words):
            make()
    with pytest.raises(al.ProblemError, match="no place for the event 'top'"):
        al.solve(problem(grid=al.Grid(1.0, 4), minimize=top.mean), transcription=al.Simultaneous())


def test_the_time_of_an_event_has_a_name_and_a_unit():
    one = problem(subject_to=[al.at("top").at_most(2.0, sigmas=1)])
    assert one.names == ("t_top",)
    assert "μ[t_top] + σ[t_top] ≤ 2" in str(one)
