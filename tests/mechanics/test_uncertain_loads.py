"""Random processes and uncertain signals as loads and parameters of mechanical systems, in problems; and bad input."""

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.transcription import transcribe
from aleator.transcription.sequential import _instantaneous as instantaneous

MOTION = {"x": al.BSpline(al.Decision(np.array([0.3, 0.6]), -3, 3), start=((0.0), 0.0), end=((1.0), 0.0))}
WIND = al.processes.RandomProcess(
    al.processes.SquaredExponentialCovariance(1.0), t_final=2.0, std=0.4, mean=1.0, modes=3
)


class Cart(al.Mechanical):
    names = ("x",)
    mass: al.Number = al.parameter("kg", positive=True, default=2.0)
    wind: al.Number = 0.0

    def mass_matrix(self, q):
        return self.mass * jnp.eye(1)

    def load(self, q, v):
        return jnp.reshape(self.wind, (1,))


def problem(model, **options):
    return al.Problem(
        al.InverseDynamics(model, motion=MOTION),
        grid=al.Grid(2.0, 8),
        minimize=al.integral("x_rate").mean,
        subject_to=[al.path("x_torque").at_most(50.0, sigmas=1.0)],
        expansion=al.Expansion(order=1),
        **options,
    )


def spread(transcription):
    """The mean and the spread of the torque over time, at the start."""
    resolved = transcription.resolve(transcription.problem.placements.vector("initial"))
    return resolved["x_torque(t)"]


def test_torques_spread_as_the_process_that_they_work_against():
    declared = problem(Cart(wind=WIND))
    found = spread(transcribe(declared))
    times = jnp.linspace(0.0, 2.0, 9)
    np.testing.assert_allclose(found.std, 0.4 * np.sqrt(1 - WIND.deficit(times)), rtol=1e-9)
    moved = spread(transcribe(problem(Cart())))
    np.testing.assert_allclose(found.mean, moved.mean - 1.0, rtol=0, atol=1e-9)


def test_masses_and_loads_that_are_uncertain_stay_affine_under_a_known_gust():
    gust = al.processes.signal(lambda t, p: jnp.sin(3.0 * t))

    class Gusty(Cart):
        size: al.Number = 1.0

        def load(self, q, v):
            return jnp.reshape(self.size * self.wind, (1,)) - 0.1 * v

    model = Gusty(mass=al.Uniform(2.0, half_width=0.5), size=al.Uniform(3.0, half_width=1.0), wind=gust)
    declared = problem(model)
    few = transcribe(declared)
    x = declared.placements.vector("initial")
    anchors = instantaneous.anchors_of(few.traced, few.collocation, x)
    assert all(anchors.affine)
    assert len(anchors.points) == 3
    times, found = np.linspace(0.0, 2.0, 9), spread(few)
    acceleration = np.asarray(
        al.simulate(al.InverseDynamics(Cart(mass=1.0), motion={"x": at(x)}), al.Grid(2.0, 8))["x_torque"]
    )
    expected = np.hypot(0.5 * acceleration, np.sin(3 * times)) / np.sqrt(3)
    np.testing.assert_allclose(found.std, expected, rtol=1e-9, atol=1e-12)


def at(x):
    return al.BSpline(x, start=(0.0, 0.0), end=(1.0, 0.0))


@pytest.mark.slow
def test_a_decided_signal_is_planned_like_any_other_number():
    # What a second engine pushes over time is decided: rest to rest in a second takes an effort of 12.
    class Effort(Cart):
        def outputs(self, motion):
            return {"effort": self.wind**2}

    push = al.BSpline(al.Decision(np.zeros(3), -20.0, 20.0), degree=1)
    declared = al.Problem(
        al.ForwardDynamics(Effort(mass=1.0, wind=push)),
        grid=al.Grid(1.0, 20),
        minimize=al.integral("effort").mean,
        subject_to=[al.terminal("x").mean.equals(1.0), al.terminal("x_rate").mean.equals(0.0)],
    )
    solution = al.solve(declared, between=1)
    assert solution.objective == pytest.approx(12.0, rel=1e-6)
    np.testing.assert_allclose(solution.decisions["wind.free"], [6.0, 0.0, -6.0], rtol=0, atol=1e-5)


class Named(al.Mechanical):
    names = ("x",)

    def mass_matrix(self, q, time):
        return jnp.eye(1)


class Few(al.Mechanical):
    names = ("x",)

    def mass_matrix(self, q):
        return jnp.eye(1)

    def load(self, q):
        return q


class Wide(Cart):
    def load(self, q, v):
        return jnp.zeros(2)


class Slide(al.Multibody):
    loads: tuple = ()
    high: al.Number = 0.0

    def bodies(self):
        return (al.Body("a", joint=al.joints.Prismatic("x"), mass=1.0, position=(0.0, 0.0, self.high)),)

    def body_loads(self, q, v):
        return self.loads() if callable(self.loads) else self.loads


RISING = al.processes.signal(lambda t, p: 0.1 * t)


def still(model):
    return al.Problem(al.ForwardDynamics(model), grid=al.Grid(1.0, 4), minimize=al.objectives.final_time())


class Thinning(Cart):
    def mass_matrix(self, q, t):
        return (1.0 - t) * jnp.eye(1)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            Named,
            r"Named\.mass_matrix: expected mass_matrix\(q\), or mass_matrix\(q, t\).*received mass_matrix\(q, time\)",
        ),
        (Few, r"Few\.load: expected load\(q, v\), or load\(q, v, t\) .*received load\(q\)"),
        (lambda: still(Wide()), r"Wide\.load\(q, v\): expected shape \(1,\); received \(2,\)"),
        (lambda: still(Slide(loads=lambda: (al.BodyLoad("b"),))), r"no body 'b'; expected one of \['a'\]"),
        (lambda: still(Slide(loads=lambda: al.BodyLoad("a"))), "body_loads returns a tuple of al.BodyLoad; received"),
        (lambda: al.BodyLoad("a", force=(1.0, 2.0)), r"BodyLoad on 'a', force: expected numbers of shape \(3,\)"),
        (lambda: al.BodyLoad("a", at=(np.nan, 0.0, 0.0)), "BodyLoad on 'a', at: expected finite numbers"),
        (lambda: still(Slide(high=RISING)), "the place or the axis of 'a' depends on time"),
        (lambda: Cart(wind=RISING).bias(jnp.zeros(1), jnp.zeros(1)), r"at an instant, such as model\.at\(0\.0\)"),
        (lambda: still(Thinning()), r"singular at t = 1 s \(x = 0\)"),
        (
            lambda: still(Cart(wind=al.Tabulated([0.0, 0.5], [1.0, 1.0]))),
            "Signal 'parameters' of ForwardDynamics is known from 0 to 0.5 s, but the grid runs from 0 to 1 s",
        ),
        (lambda: still(Cart(mass=WIND)), "'mass' must stay positive, but a RandomProcess is Gaussian at every instant"),
        (lambda: still(Cart(mass=al.processes.signal(lambda t, p: 0.5 - t))), "is singular about t = 0.5 s"),
        (
            lambda: al.simulate(al.ForwardDynamics(Cart()), al.Grid(1.0, 4), {"parameters": RISING}),
            r"ForwardDynamics takes no inputs: .* received the inputs \['parameters'\]",
        ),
        (
            lambda: al.ForwardDynamics(Cart()).starting(0.0, {"parameters": jnp.zeros((1, 1))}),
            "Cart: expected no parameters that change with time; received an input of that name",
        ),
    ],
)
def test_loads_and_times_that_make_no_sense_are_refused_in_words(wrong, message):
    with pytest.raises(al.ProblemError, match=message):
        wrong()


def test_a_positive_function_of_a_process_is_a_mass():
    noise = al.processes.RandomProcess(al.processes.SquaredExponentialCovariance(1.0), t_final=2.0, std=0.05, modes=2)
    mass = al.processes.signal(lambda t, p: 2.0 * jnp.exp(p.noise(t)), noise=noise)
    found = spread(transcribe(problem(Cart(mass=mass))))
    assert np.all(np.asarray(found.std) >= 0)
    assert np.asarray(found.std).max() > 0.01
