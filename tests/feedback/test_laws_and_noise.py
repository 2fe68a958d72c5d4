"""Regulators, computed torque and white noise, against closed forms; and what is refused."""

import warnings
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
import scipy

import aleator as al
from aleator.feedback import AbstractController
from zoo import histories, optimum


class Mass(al.System):
    """A mass of 1 kg with a force and a disturbance, which may start with a speed."""

    states = ("x", "v")
    speed: al.Number = 0.0

    def rhs(self, t, z, u, w=0.0):
        return z.v, u + w

    def initial(self):
        return {"v": self.speed}

    def outputs(self, t, z, u):
        return {"x": z.x, "v": z.v, "cost": z.x**2 + 0.1 * u**2}


STILL = {"u": al.BSpline(al.Decision(np.zeros(4), -1.0, 1.0))}


def moved(feedback: Any, system: Any = None, inputs: Any = STILL, end: float = 2.0, steps: int = 100, **options: Any):
    options = {"minimize": al.terminal("x").mean} | options
    system = Mass() if system is None else system
    return al.Problem(system, grid=al.Grid(end, steps), inputs=inputs, feedback=feedback, **options)


def test_the_regulator_of_a_double_integrator_is_that_of_its_closed_form():
    # Of Q = diag(1, 0) and R = 0.1: K = (√10, √(2√10)), and S₂₂ = R K₂ is the cost of a start at unit speed.
    problem = moved(
        al.Feedback(gains=al.lqr([1.0, 0.0], [0.1])),
        Mass(speed=al.Normal(0.0, 1.0)),
        end=10.0,
        steps=200,
        minimize=al.integral("cost").mean,
    )
    objective = optimum(problem).objective
    assert objective == pytest.approx(0.251487, rel=5e-6)
    assert objective == pytest.approx(0.1 * np.sqrt(2 * np.sqrt(10)), rel=5e-6)


def test_gains_along_a_plan_are_those_of_the_riccati_equation_by_scipy():
    class Swing(Mass):
        def rhs(self, t, z, u):
            return z.v, jnp.sin(z.x) + (2.0 + z.x) * u

    Q, R, final = np.diag([2.0, 1.0]), 0.5, np.diag([3.0, 0.5])
    feedback = al.Feedback(gains=al.lqr(Q, [R], final=final))
    problem = moved(feedback, Swing(speed=1.0), {"u": al.Control(0.3, -1, 1, degree=1)}, 1.0, 20)
    gains = np.asarray(histories(problem, np.zeros((1, 0)))["lqr.gains"])[0, :, 0]

    def planned(t, z):
        return [z[1], np.sin(z[0]) + (2 + z[0]) * 0.3]

    plan = scipy.integrate.solve_ivp(planned, (0, 1), [0, 1.0], dense_output=True, rtol=1e-11, atol=1e-12)

    def effect(t):
        return np.array([[0.0], [2 + plan.sol(t)[0]]])

    def rate(s, flat):  # with the time that is left
        x, S = plan.sol(1 - s)[0], flat.reshape(2, 2)
        A, B = np.array([[0, 1], [np.cos(x) + 0.3, 0]]), effect(1 - s)
        return (A.T @ S + S @ A - S @ B @ B.T @ S / R + Q).ravel()

    left = 1 - np.linspace(0, 1, 21)
    S = scipy.integrate.solve_ivp(rate, (0, 1), final.ravel(), t_eval=left[::-1], rtol=1e-10, atol=1e-11).y.T[::-1]
    expected = [effect(1 - s)[:, 0] @ one.reshape(2, 2) / R for s, one in zip(left, S, strict=True)]
    np.testing.assert_allclose(gains, expected, atol=2e-6)


@pytest.mark.slow
def test_computed_torque_makes_errors_linear():
    class Pendulum(al.Lagrangian):
        names = ("angle",)
        m: al.Number = 1.3

        def kinetic_energy(self, q, v):
            return 0.5 * self.m * (1.0 + jnp.cos(q[0]) ** 2) * v[0] ** 2

        def potential_energy(self, q):
            return -9.81 * self.m * jnp.cos(q[0])

    system = al.ForwardDynamics(
        Pendulum(),
        torque={"angle_torque": al.Control(2.0, -9, 9, degree=1)},
        start={"angle": al.Uniform(0.0, half_width=0.5)},
    )
    feedback = al.Feedback(gains=al.computed_torque(25.0, 10.0))
    problem = al.Problem(system, grid=al.Grid(1.0, 100), feedback=feedback, minimize=al.terminal("angle").mean)
    error = np.asarray(histories(problem, [[0.8]])["q.error"])[0, :, 0]
    t = np.linspace(0, 1, 101)  # both poles at -5 1/s
    np.testing.assert_allclose(error, error[0] * (1 + 5 * t) * np.exp(-5 * t), atol=1e-7)
    assert abs(error[0]) == pytest.approx(0.4)


def lyapunov(k, d, W, N, t):
    """The covariance of the states at a time: of a loop with a noisy force, intensity `W`, and a noisy place, `N`."""
    A, B = np.array([[0, 1], [-k, -d]]), np.array([[0, 0], [1, k]])
    stationary = scipy.linalg.solve_continuous_lyapunov(A, -B @ np.diag([W, N]) @ B.T)
    grown = scipy.linalg.expm(A * t)
    return stationary - grown @ stationary @ grown.T


def test_the_covariance_of_a_noisy_loop_is_that_of_lyapunov():
    white = al.processes.WhiteNoise
    problem = moved(
        al.Feedback(gains=[4.0, 2.0], of=("x", "v"), noise={"x": white(1e-3)}),
        inputs=STILL | {"w": white(0.3)},
        steps=400,
        subject_to=[al.path("x").std <= 9.0, al.terminal("v").std <= 9.0],
    )
    history = histories(problem, np.zeros((1, 0)))
    expected = np.array([np.diag(lyapunov(4.0, 2.0, 0.3, 1e-3, t)) for t in np.linspace(0, 2, 401)])
    np.testing.assert_allclose(history["x.variance"][0], expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(history["v.variance"][0], expected[:, 1], atol=1e-8)


def test_noise_adds_its_variance_to_that_of_the_distributions():
    class Pulled(Mass):
        def rhs(self, t, z, u, w=0.0):
            return z.v, u + w + self.speed

        def initial(self):
            return {}

    problem = moved(
        al.Feedback(gains=[4.0, 2.0], to="u"),
        Pulled(speed=al.Normal(0.0, 0.5)),
        STILL | {"w": al.processes.WhiteNoise(al.Decision(0.3, 0.1, 0.5))},
        minimize=al.terminal("x").std,
        subject_to=[al.terminal("v").variance <= 9.0],
    )
    solution = optimum(problem)
    assert solution.decisions["inputs.w.intensity"] == pytest.approx(0.1)
    rate = np.sqrt(3.0)  # of a pull of 1 N: x = (1 - exp(-t) (cos √3 t + sin √3 t / √3)) / 4
    pulled = (1 - np.exp(-2) * (np.cos(2 * rate) + np.sin(2 * rate) / rate)) / 4
    variance = lyapunov(4.0, 2.0, 0.1, 0.0, 2.0)[0, 0] + (0.5 * pulled) ** 2
    assert solution.objective == pytest.approx(np.sqrt(variance), rel=1e-6)


def noisy(**options: Any) -> al.Problem:
    return moved(al.Feedback(gains=[4.0, 2.0], of=("x", "v"), noise=al.processes.WhiteNoise(1e-3)), **options)


class Damping(AbstractController):
    """A law that measures a speed."""

    def command(self, t, measured, plan):
        return {"u": plan.states.v - measured.v}


class Stopped(Mass):
    """A mass that stops where its force is as large as its speed."""

    events: ClassVar = {"stop": al.Event(lambda self, t, z, u: z.v - u, jump=lambda self, t, z, u: {"v": 0.0 * u})}


WRONG = {
    r"Damping.command raised AttributeError.*expected one of \('x',\)": lambda: moved(al.Feedback(Damping(), of="x")),
    "destabilise": lambda: moved(al.Feedback(gains=[-4.0, 2.0])),
    "to the planned input": lambda: moved(al.Feedback(gains=[4.0, -2.0])),
    "ask for what is not measured": lambda: moved(al.Feedback(gains={"x": 4.0, "v": 2.0}, of="x")),
    "received 'y'": lambda: moved(al.Feedback(gains=[4.0], of="y")),
    "eigenvalues are positive": lambda: al.lqr([1.0, 0.0], [-1.0]),
    "expected weights of 2 states": lambda: moved(al.Feedback(gains=al.lqr([1.0, 1.0, 1.0], [1.0]))),
    "the least value before the largest": lambda: al.Feedback(gains=4.0, limits=(1.0, -1.0)),
    "contains white noise itself": lambda: noisy(subject_to=[al.path("u.command").std <= 1.0]),
    "no covariance tells": lambda: noisy(minimize=al.terminal("x").quantile(0.9)),
    "a part of another signal": lambda: moved(
        None, inputs={"u": al.processes.total(al.StepFunction([1.0], [0.0, 1.0]), al.processes.WhiteNoise(1.0))}
    ),
    "expected a system with states; received Phases": lambda: al.Problem(
        al.Phases(only=al.Phase(Mass(), al.Grid(1.0, 10), inputs=STILL)),
        feedback=al.Feedback(gains=[4.0, 2.0]),
        minimize=al.terminal("x").mean,
    ),
    "'stop' of Stopped depends on inputs": lambda: moved(None, Stopped(), STILL | {"w": al.processes.WhiteNoise(1.0)}),
}


def test_a_noisy_problem_can_be_declared_anew():
    problem = noisy(subject_to=[al.terminal("x").std <= 9.0])
    assert al.soft(problem, weight=1.0).objective.leaves[-1].text() == "σ[x(t_f)]"


@pytest.mark.parametrize("sentence", WRONG)
def test_what_is_wrong_is_said_in_a_sentence(sentence):
    with pytest.raises(al.ProblemError, match=sentence):
        WRONG[sentence]()


def test_expansions_beside_noise_are_judged_by_the_whole_spread():
    """A transient of 1e-11 that order 3 misses says nothing of a spread of 0.1 that noise causes."""

    class Filter(al.System):
        states = ("x",)
        rate: al.Number

        def initial(self):
            return {"x": 1.0}

        def rhs(self, t, z, w):
            return (-self.rate * z.x + w,)

        def outputs(self, t, z):
            return {"x": z.x}

    solution = al.solve(
        al.Problem(
            Filter(al.Uniform(al.Decision(6.0, 2.0, 20.0), half_width=1.5)),
            grid=al.Grid(4.0, 200),
            inputs={"w": al.processes.WhiteNoise(0.1)},
            minimize=al.value("rate.mean"),
            subject_to=[al.terminal("x").std <= 0.1],
        )
    )

    def excess(mean):  # the variance, that of noise averaged over rates, over its bound
        return 0.1 / 2 * np.log((mean + 1.5) / (mean - 1.5)) / 3.0 - 0.01

    assert solution.decisions["rate.mean"] == pytest.approx(scipy.optimize.brentq(excess, 2, 20), rel=1e-4)
    assert solution.certificate.expansion.leave_one_out["x(t_f)"] < 1e-3


@pytest.mark.slow
def test_what_noise_adds_is_compared_with_samples_and_no_system_is_counted_without_it():
    """Once settled the variance of a speed is `S / (2 c)` for every stiffness: its spread is rounding."""

    class Oscillator(al.System):
        states = ("x", "v")
        k: al.Number

        def rhs(self, t, z, w):
            return z.v, -self.k * z.x - 0.6 * z.v + w

        def outputs(self, t, z):
            return {"x": z.x, "v": z.v}

    slow, place = al.terminal("v"), al.terminal("x")
    problem = al.Problem(
        Oscillator(al.Uniform(al.Decision(4.0, 1.0, 20.0), half_width=0.5)),
        grid=al.Grid(30.0, 600),
        inputs={"w": al.processes.WhiteNoise(0.3)},
        minimize=al.value("k.mean"),
        subject_to=[slow.std <= 0.6, place.at_most(0.4, sigmas=2).named("place")],
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solution = al.solve(problem)
        evidence = al.validate(solution, 2000)
    assert float(solution.statistics["σ[v(t_f)]"]) == pytest.approx(0.5, rel=1e-6)
    assert evidence.agrees
    assert not evidence.broken
    with pytest.raises(al.ProblemError, match="beside white noise"):
        al.calibrate(problem, "place", target=0.05)
    with pytest.raises(al.ProblemError, match="none is counted"):
        al.rare_violation(solution, "place")
