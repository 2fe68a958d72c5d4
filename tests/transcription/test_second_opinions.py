"""Fresh simulations at the answer: they agree where an expansion is right, and sound the alarm where it is not."""

import warnings

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
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
    assert "do not confirm" in solution.verdict
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


@algebraic
def part(d, u, place, slope):
    """A gain, and a price in a narrow part of the germ that no collocation point meets."""
    return {"cost": jnp.where(jnp.abs(u - place) < 0.0075, 100.0 * d**2, 0.0) + slope * u - d}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("slope", "place"), [(0.0, 0.05), (1.0, 0.77)])
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


def test_what_a_model_simulates_by_itself_is_checked_on_more_steps_too():
    model = EndOfSpring(al.Decision(9.0, 4.0, 16.0))
    with pytest.raises(al.SolveError, match="grids inside the model"):
        al.solve(al.Problem(model, minimize=al.output("x").mean))


class Slide(al.System):
    """It comes from far to rest near `aim`, by a millimetre off that depends on the rotor's angle `phi`."""

    states = ("x",)
    start: al.Number
    phi: al.Number
    aim: al.Number
    rate: al.Number

    def initial(self):
        return {"x": self.start}

    def rhs(self, t, z):
        return (self.rate * (self.aim + 1e-3 * jnp.cos(7 * self.phi) - z.x),)

    def outputs(self, t, z):
        return {"x": z.x, "both": jnp.stack([z.x, 1e3 * z.x + 1e6 * self.start])}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("limited", "variables"), [(al.path("x"), 2), (al.terminal("both"), 2), (al.path("x"), 3)], ids=str
)
def test_an_instant_and_an_entry_of_little_spread_are_judged_by_their_own(limited, variables):
    """The distance travelled, and a large entry beside it, vary by hundreds of times as much as the place of rest."""
    rate = al.Uniform(5.0, half_width=0.1) if variables == 3 else 5.0
    model = Slide(
        al.Uniform(-0.5, half_width=0.25), al.Uniform(0.0, half_width=1.0), al.Decision(0.0, -1e-2, 1e-2), rate
    )
    problem = al.Problem(
        model,
        grid=al.Grid(4.0, 100),
        minimize=-al.value("aim"),
        subject_to=[limited.at_most(2e-3, sigmas=2)],
        expansion=al.Expansion(order=3),
    )
    solution = al.solve(problem, throw=False)
    mean, spread = np.sin(7) / 7e3, 1e-3 * np.sqrt(0.5 + np.sin(14) / 28 - (np.sin(7) / 7) ** 2)
    assert solution.decisions["aim"] + mean + 2 * spread > 2.5e-3  # what the expansion calls optimal breaks the limit
    assert not solution.ok
    assert "broken" in solution.why()
    assert not al.validate(solution, 4000).agrees
