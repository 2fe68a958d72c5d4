"""Fresh simulations at the answer: they agree where an expansion is right, and sound the alarm where it is not."""

import warnings

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import aleator as al
from aleator.certification._fresh import fresh_systems
from aleator.certification._second_opinion import _quantile
from zoo import LOSS, ONE_STEP, algebraic, gain_problem

BOUND = 2.0


class Comb(al.System):
    """A line, and teeth between the twelve points of order 3, of which none knows: `E[y] = gain teeth / 2`."""

    states = ("nothing",)
    gain: al.Number
    theta: al.Number
    teeth: al.Number

    def rhs(self, t, z):
        return (0.0 * z.nothing,)

    def outputs(self, t, z):
        y = self.gain * (self.theta + self.teeth * jnp.cos(6 * jnp.pi * self.theta) ** 2)
        return {"y": y, "loss": (self.gain - 3.0) ** 2}


def comb_problem(teeth, bound=BOUND):
    """With limits of every kind, of which the first may be near."""
    y, over = al.terminal("y"), al.path("y")
    limits = (
        (y.mean <= bound).named("mean"),
        over.std <= 50.0,
        al.objectives.norm(y.mean, y.skewness) <= 500.0,
        al.time_integral(over.mean) <= 90.0,
    )
    return al.Problem(
        Comb(al.Decision(0.5, 0.0, 10.0), al.Uniform(1.0, half_width=1.0), teeth),
        grid=ONE_STEP,
        minimize=LOSS.mean,
        subject_to=limits,
        expansion=al.Expansion(3),
    )


def test_a_smooth_design_is_confirmed_and_told_so():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solution = al.solve(gain_problem())
    assert solution.certificate.opinion is not None
    assert solution.certificate.opinion.agrees
    assert "256 fresh simulations agree" in str(solution)


def test_a_limit_that_only_the_expansion_meets_is_no_solution():
    with pytest.warns(al.ExpansionWarning, match="fresh simulations disagree"):
        solution = al.solve(comb_problem(0.6), throw=False)
    # No point sees the teeth: by the expansion all is well.
    assert solution.certificate.expansion.worst < 1e-6
    assert solution.decisions["gain"] == pytest.approx(BOUND, rel=1e-6)
    assert not solution.ok
    assert "contradict" in solution.verdict
    with pytest.raises(
        al.SolveError, match=r"fresh simulations do not confirm it: 'mean' is broken by .*Raise the order"
    ):
        al.solve(comb_problem(0.6))


def test_the_correction_is_that_of_the_closed_form_and_every_limit_is_judged():
    with pytest.warns(al.ExpansionWarning, match="fresh simulations disagree"):
        solution = al.solve(comb_problem(0.6, bound=50.0))
    assert solution.ok  # far from their bounds, limits are not broken
    told = [one for one in solution.certificate.opinion.contradictions if one.startswith("μ[y(t_f)]")]
    by, error = (float(part) for part in told[0].split(" differs by ")[1].split(" in ")[0].split(" ± "))
    # The teeth's mean, and its standard error over so many systems: cos² spreads by 1 / sqrt(8).
    gain = solution.decisions["gain"]
    assert error == pytest.approx(gain * 0.6 / np.sqrt(8 * solution.certificate.opinion.samples), rel=0.3)
    assert abs(by - gain * 0.6 / 2) < 4 * error
    every = " ".join(solution.certificate.opinion.contradictions)
    assert "‖μ[y(t_f)], Skew[y(t_f)]‖" in every
    assert "∫μ[y(t)] dt" in every


def test_small_teeth_are_warned_of_and_leave_a_design_a_solution():
    with pytest.warns(al.ExpansionWarning, match="fresh simulations disagree"):
        solution = al.solve(comb_problem(0.04))
    assert solution.ok
    assert not solution.certificate.opinion.agrees
    assert solution.certificate.opinion.broken == ""


@pytest.mark.parametrize(
    "germs", [(al.Uniform(0.5, half_width=0.5),), (al.Normal(0.0, 1.0), al.Uniform(0.0, half_width=1.0))]
)
def test_weights_of_fresh_systems_give_the_moments_of_all(germs):
    basis, draws = [one.germ() for one in germs], 200
    several = [fresh_systems(basis, 32, draw) for draw in range(draws)]
    weights, first = (
        np.array(part) for part in ([one.weights for one in several], [one.points[:, 0] for one in several])
    )
    assert weights.max() <= 2.0
    for power, exact in ((0, 1.0), (1, 0.0), (2, 1.0 if len(germs) == 2 else 1 / 3)):
        means = np.mean(weights * first**power, axis=1)
        assert abs(means.mean() - exact) < 4 * means.std() / np.sqrt(draws)
    # Each of them has systems at which random ones hardly ever arrive.
    beyond = scipy.stats.norm.ppf(0.999) if len(germs) == 2 else 0.998
    assert all((one.points[:, 0] > beyond).any() and (one.points[:, 0] < -beyond).any() for one in several)


def spiked(a, centre, height, exp=jnp.exp):
    """A line of slope 0.1, and a spike that no collocation point sees."""
    return 1 + 0.1 * a + height * exp(-(((a - centre) / 0.003) ** 2))


Spiked = algebraic(lambda k, a, centre, height: {"g": k * spiked(a, centre, height)})


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("centre", "height", "sigmas"), [pytest.param(0.6, 100.0, 0.0, marks=pytest.mark.slow), (0.2345, 20.0, 1.0)]
)
def test_a_rare_event_that_breaks_a_limit_is_drawn_more_often_before_the_design_is_accepted(centre, height, sigmas):
    problem = al.Problem(
        Spiked(al.Decision(1.0, 0.0, 10.0), al.Uniform.bounds(0.0, 1.0), centre, height),
        minimize=-al.value("k"),
        subject_to=[al.output("g").at_most(5.0, sigmas=sigmas)],
        expansion=al.Expansion(order=3),
    )
    solution = al.solve(problem, throw=False)
    levels = (np.arange(10**5) + 0.5) / 1e5
    true = solution.decisions["k"] * spiked(levels, centre, height, np.exp)
    assert true.mean() + sigmas * true.std() > 1.2 * 5.0
    assert not solution.ok
    assert "fresh simulations do not confirm" in solution.why()


def test_all_fresh_systems_of_one_or_two_germs_cover_their_range_evenly():
    one, two = (
        np.concatenate(
            [fresh_systems([al.Uniform(0.5, half_width=0.5).germ()] * germs, 32, draw).points for draw in range(8)]
        )
        for germs in (1, 2)
    )
    assert np.diff(np.sort(one[:, 0]), prepend=-1.0, append=1.0).max() / 2 < 0.015
    # In each cell of a grid over both.
    cells = np.floor((two + 1) / 2 * np.array([[7, 7]]) * (1 - 1e-12)).astype(int)
    assert len(np.unique(cells, axis=0)) == 49


@algebraic
def part(d, u, place, slope):
    """A gain, and a price in a narrow part of the germ that no collocation point meets."""
    return {"cost": jnp.where(jnp.abs(u - place) < 0.0075, 100.0 * d**2, 0.0) + slope * u - d}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("slope", "place"), [(0.0, 0.05), (0.0, 0.5), (1.0, 0.3), (1.0, 0.77)])
def test_a_part_of_one_and_a_half_percent_of_the_only_germ_that_costs_dearly_is_found(place, slope):
    model = part(al.Decision(1.0, 0.0, 10.0), al.Uniform.bounds(0.0, 1.0), place, slope)
    solution = al.solve(al.Problem(model, minimize=al.output("cost").mean), throw=False)
    # E[cost] = 1.5 d² - d + slope / 2: at d = 10 it is 140, the expansion says -10.
    assert solution.objective == pytest.approx(slope / 2 - 10.0)
    assert not solution.ok
    by, error = (
        float(part) for part in solution.certificate.opinion.broken.split("differs by ")[1].split(",")[0].split(" ± ")
    )
    assert abs(by - 150.0) < 3 * error < 150.0


@pytest.mark.filterwarnings("ignore")
def test_an_outlier_of_hardly_any_weight_is_a_reason_to_draw_more():
    """A jump in a corner of 4 % that no point sees, and one fresh system does: in the utmost tail of its germ."""
    corner = algebraic(lambda k, a, b: {"g": k + 0.1 * a + 0.05 * b + jnp.where((a < -0.6) & (b > 0.6), 1.0, 0.0)})
    parts = [al.Uniform(0.0, half_width=1.0) for _ in range(2)]
    limit = al.output("g").at_most(1.0, sigmas=2.0)
    problem = al.Problem(corner(al.Decision(0.0, -9.0, 9.0), *parts), minimize=-al.value("k"), subject_to=[limit])
    solution = al.solve(problem, throw=False)
    # Mean and variance of the jump are 0.04 and 0.04 x 0.96; at its place a is -0.8 and b is 0.8 in the mean.
    variance = (0.1**2 + 0.05**2) / 3 + 0.04 * 0.96 + 2 * 0.04 * (-0.8 * 0.1 + 0.8 * 0.05)
    assert float(solution.decisions["k"]) + 0.04 + 2 * np.sqrt(variance) > 1.2
    assert not solution.ok


@pytest.mark.filterwarnings("ignore")
def test_what_is_tiny_beside_an_outermost_point_of_no_weight_is_not_certain():
    """`E exp(s x) = 1 / (1 - s)` for exponential `x`: 1e21 at the last point of order 12, of weight 3e-22."""
    growth = algebraic(lambda s, x: {"g": jnp.exp(s * x), "rate": s})
    system = growth(al.Decision(0.1, 0.01, 0.9), al.Exponential(mean=1.0))
    limit = al.output("g").mean <= 1.8
    problem = al.Problem(system, minimize=-al.output("rate").mean, subject_to=[limit], expansion=al.Expansion(12))
    solution = al.solve(problem, throw=False)
    # The optimum is at 4/9.
    assert float(solution.decisions["s"]) > 0.45
    assert not solution.ok
    assert not solution.certificate.opinion.agrees
    assert solution.certificate.expansion.leave_one_out["g"] == pytest.approx(1.2, abs=0.2)


@pytest.mark.slow
def test_a_limit_is_held_to_a_part_of_its_spread_however_large_its_bound_is():
    problem = al.Problem(
        algebraic(lambda k, a: {"g": 1e9 + k + 0.1 * a})(al.Decision(1.0, 0.0, 10.0), al.Normal(0.0, 1.0)),
        minimize=-al.value("k"),
        subject_to=[al.output("g").at_most(1e9 + 2.0, sigmas=1.0)],
        expansion=al.Expansion(order=2),
    )
    # One standard deviation of 0.1 below 2; a hundredth of it is tolerated.
    assert al.solve(problem).decisions["k"] == pytest.approx(1.9, abs=1e-3)


class Lag(al.System):
    """A stiff state that follows a set point, which no explicit method of a hundred steps can follow."""

    states = ("x",)
    k: al.Number
    to: al.Number

    def initial(self):
        return {"x": 1.0}

    def rhs(self, t, z):
        return (-self.k * (z.x - self.to),)

    def outputs(self, t, z):
        return {"x2": z.x**2}


@pytest.mark.slow
def test_a_stiff_model_is_checked_by_a_method_that_can():
    x2 = al.terminal("x2")
    problem = al.Problem(
        Lag(al.Uniform(2e4, half_width=1e3), al.Decision(0.5, 0.0, 2.0)),
        grid=al.Grid(1.0, 20),
        minimize=(x2.mean - 0.25) ** 2 + x2.variance,
        expansion=al.Expansion(2),
    )
    solution = al.solve(problem, transcription=al.Simultaneous(al.schemes.Radau(2)))
    assert solution.decisions["to"] == pytest.approx(0.5, rel=1e-6)
    assert solution.certificate.grid_error.integrator == "Rodas5P"
    assert solution.certificate.opinion.agrees


@pytest.mark.slow
def test_an_integral_that_nothing_uncertain_enters_is_no_contradiction():
    class Effort(al.System):
        states = ("x",)
        k: al.Number

        def rhs(self, t, z, u):
            return (self.k * (u - z.x),)

        def outputs(self, t, z, u):
            return {"x": z.x, "u2": u**2}

    problem = al.Problem(
        Effort(al.Uniform(5.0, half_width=1.0)),
        grid=al.Grid(1.0, 20),
        integrator=al.integrators.Tsit5(),
        inputs={"u": al.BSpline(al.Decision(np.full(6, 0.5), 0.0, 2.0))},
        minimize=(al.terminal("x").mean - 0.5) ** 2 + 1e-3 * al.integral("u2").mean,
        expansion=al.Expansion(3),
    )
    solution = al.solve(problem)
    assert solution.certificate.opinion.agrees
    assert solution.certificate.expansion.unresolved == ()


class Spring(al.System):
    states = ("x", "v")
    stiffness: al.Number

    def initial(self):
        return {"x": 1.0}

    def rhs(self, t, z):
        return z.v, -self.stiffness * z.x

    def outputs(self, t, z):
        return {"x": z.x}


class EndOfSpring(al.AlgebraicSystem):
    """A model that simulates by itself: `x = cos(duration sqrt(stiffness))`."""

    stiffness: al.Number
    duration: al.Number = 10.0
    steps: int = 20

    def outputs(self):
        history = al.simulate(Spring(self.stiffness), al.Grid(self.duration, self.steps), only=["x"])
        return {"x": history["x"][-1]}


@pytest.mark.parametrize(("steps", "is_right"), [(20, False), pytest.param(400, True, marks=pytest.mark.slow)])
def test_what_a_model_simulates_by_itself_is_checked_on_more_steps_too(steps, is_right):
    model = EndOfSpring(al.Decision(9.0, 4.0, 16.0), steps=steps)
    problem = al.Problem(model, minimize=al.output("x").mean)
    if not is_right:
        with pytest.raises(al.SolveError, match="grids inside the model"):
            al.solve(problem)
        return
    solution = al.solve(problem)
    right = np.cos(10.0 * np.sqrt(float(solution.decisions["stiffness"])))
    assert solution.ok
    assert abs(solution.objective - right) < 1e-5


@pytest.mark.parametrize("chance", [0.4, 1e-2, 1e-5])
def test_quantiles_of_student_are_those_of_scipy(chance):
    assert abs(_quantile(29, chance) / -scipy.special.stdtrit(29, chance) - 1) < 1e-4
