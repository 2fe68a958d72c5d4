"""Uncertainty analysis beside its peers: the same trajectory to the same error, and statistics of a large expansion.

    python benchmarks/uq.py [--full]

Everything is measured in this one run, on a warm process: what is compiled or imported once is left out for all.
`--full` also lets chaospy compute its standard deviation of the largest expansion, which takes minutes.
"""

import sys
import time
import warnings
from collections.abc import Callable
from itertools import product
from math import comb
from typing import NamedTuple

import chaospy
import jax.numpy as jnp
import numpy as np
import openturns as ot

import aleator as al
from aleator.uncertainty import HermiteGerm, LegendreGerm

STEPS, T_FINAL, GRAVITY = 500, 10.0, 9.81
TARGET = 1e-4
HIGHEST = 12
SEED = 0


class Pendulum(al.System):
    """A damped pendulum, released at rest: its length, damping and first angle are uncertain."""

    states = ("angle", "rate")
    length: al.Number = al.parameter("m", positive=True)
    damping: al.Number = al.parameter("1/s")
    start: al.Number = al.parameter("rad")

    def initial(self):
        """At rest."""
        return {"angle": self.start}

    def rhs(self, t, z):
        """Gravity and damping."""
        del t
        return z.rate, -GRAVITY / self.length * jnp.sin(z.angle) - self.damping * z.rate

    def outputs(self, t, z):
        """The angle, rad."""
        del t
        return {"angle": z.angle}


LENGTH, DAMPING, START = (0.95, 1.05), (0.15, 0.25), (0.8, 0.05)
MODEL = {
    "pendulum": Pendulum(al.Uniform.bounds(*LENGTH), al.Uniform.bounds(*DAMPING), al.Normal(*START)),
}
GRID = al.Grid(T_FINAL, STEPS)


def by_aleator(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of the angle at every instant."""
    expanded = al.expand(lambda model: al.simulate(model["pendulum"], GRID)["angle"], MODEL, al.Expansion(order=order))
    return np.asarray(expanded.mean), np.asarray(expanded.std)


def angles(parameters: np.ndarray) -> np.ndarray:
    """The angle of many pendulums (rows of length, damping, start) at every instant, in plain vectorised NumPy."""
    length, damping, angle = parameters.T
    rate, step = np.zeros_like(angle), T_FINAL / STEPS
    histories = np.empty((STEPS + 1, len(angle)))
    histories[0] = angle

    def slope(angle: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return rate, -GRAVITY / length * np.sin(angle) - damping * rate

    for k in range(STEPS):
        a1, r1 = slope(angle, rate)
        a2, r2 = slope(angle + step / 2 * a1, rate + step / 2 * r1)
        a3, r3 = slope(angle + step / 2 * a2, rate + step / 2 * r2)
        a4, r4 = slope(angle + step * a3, rate + step * r3)
        angle = angle + step / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        rate = rate + step / 6 * (r1 + 2 * r2 + 2 * r3 + r4)
        histories[k + 1] = angle
    return histories.T


def by_chaospy(order: int) -> tuple[np.ndarray, np.ndarray]:
    """The same by chaospy: three points for each term, least squares."""
    joint = chaospy.J(chaospy.Uniform(*LENGTH), chaospy.Uniform(*DAMPING), chaospy.Normal(*START))
    basis = chaospy.generate_expansion(order, joint)
    points = joint.sample(3 * len(basis), rule="hammersley")
    fitted = chaospy.fit_regression(basis, points, angles(points.T))
    return np.asarray(chaospy.E(fitted, joint)), np.asarray(chaospy.Std(fitted, joint))


def by_openturns(order: int) -> tuple[np.ndarray, np.ndarray]:
    """The same by OpenTURNS: three points for each term, least squares over the whole basis."""
    distributions = [ot.Uniform(*LENGTH), ot.Uniform(*DAMPING), ot.Normal(*START)]
    joint, count = ot.JointDistribution(distributions), ot.LinearEnumerateFunction(3).getStrataCumulatedCardinal(order)
    basis = ot.OrthogonalProductPolynomialFactory(distributions)
    points = ot.LowDiscrepancyExperiment(ot.SobolSequence(), joint, 3 * count).generate()
    algorithm = ot.LeastSquaresExpansion(points, ot.Sample(angles(np.asarray(points))), joint, basis, count, "QR")
    algorithm.run()
    moments = ot.FunctionalChaosRandomVector(algorithm.getResult())
    coefficients = np.asarray(algorithm.getResult().getCoefficients())
    return np.asarray(moments.getMean()), np.sqrt(np.sum(coefficients[1:] ** 2, axis=0))


def exact() -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation by tensor Gauss quadrature, with as many nodes as it takes."""
    uniform, weights = LegendreGerm().gauss(24)
    normal, normal_weights = HermiteGerm().gauss(24)
    columns = [
        np.mean(LENGTH) + np.ptp(LENGTH) / 2 * uniform,
        np.mean(DAMPING) + np.ptp(DAMPING) / 2 * uniform,
        START[0] + START[1] * normal,
    ]
    values = angles(np.array(list(product(*columns))))
    weight = np.array([a * b * c for a, b, c in product(weights, weights, normal_weights)])
    mean = weight @ values
    return mean, np.sqrt(weight @ (values - mean) ** 2)


class Reached(NamedTuple):
    """The lowest order that reaches the target, its error, and its time, s."""

    order: int
    error: float
    seconds: float


def timed(function: Callable[[], object], repeats: int = 3) -> float:
    """The shortest of some times, s."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)


def reach(method: Callable[[int], tuple[np.ndarray, np.ndarray]], truth: tuple[np.ndarray, np.ndarray]) -> Reached:
    """Raise the order until mean and standard deviation are within the target at every instant."""
    for order in range(1, HIGHEST + 1):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", al.ExpansionWarning)  # low orders rightly warn
            values = method(order)
        error = max(float(np.max(np.abs(a - b))) for a, b in zip(values, truth, strict=True))
        if error <= TARGET:
            return Reached(order, error, timed(lambda order=order: method(order)))
    raise SystemExit(f"order {HIGHEST} does not reach {TARGET}")


def compare_trajectories() -> None:
    """Time to a given error of a trajectory's mean and standard deviation."""
    print(
        f"Damped pendulum, 3 variables, {STEPS} steps; mean and std of the angle within {TARGET:g} rad at all instants"
    )
    truth = exact()
    methods = {"aleator": by_aleator, "chaospy": by_chaospy, "OpenTURNS": by_openturns}
    found = {name: reach(method, truth) for name, method in methods.items()}
    for name, one in found.items():
        ratio = one.seconds / found["aleator"].seconds
        reached = f"order {one.order}, error {one.error:.1e}"
        print(f"  {name:<10} {reached}, {1e3 * one.seconds:8.1f} ms, {ratio:6.1f} times aleator")
    print("  (chaospy and OpenTURNS solve the pendulum by vectorised NumPy; the time of that alone for as many points:")
    parameters = np.tile([[1.0, 0.2, 0.8]], (3 * comb(3 + found["chaospy"].order, 3), 1))
    print(f"   {1e3 * timed(lambda: angles(parameters)):.1f} ms)")


def compare_statistics(full: bool) -> None:
    """Statistics of an expansion in 8 variables of order 4."""
    variables, order = 8, 4
    distributions = {f"x{i}": al.Uniform.bounds(-1.0, 1.0) for i in range(variables)}
    weights = np.random.default_rng(SEED).normal(size=variables)

    def response(x: dict) -> jnp.ndarray:
        z = sum(w * value for w, value in zip(weights, x.values(), strict=True))
        return jnp.exp(0.3 * z) + x["x0"] * x["x7"]

    expanded = al.expand(response, distributions, al.Expansion(order=order))
    print(f"Statistics of an expansion in {variables} variables of order {order}: {expanded.basis.terms} terms")
    statistics: dict[str, Callable[[], object]] = {
        "mean": lambda: expanded.mean,
        "std": lambda: expanded.std,
        "skewness": lambda: expanded.skewness,
        "kurtosis": lambda: expanded.kurtosis,
        "first Sobol indices of all": lambda: [expanded.sobol(name) for name in distributions],
        "total Sobol indices of all": lambda: [expanded.total_sobol(name) for name in distributions],
        "0.99 quantile": lambda: expanded.quantile(0.99),
    }
    for name, statistic in statistics.items():
        start = time.perf_counter()
        np.asarray(statistic())
        first = time.perf_counter() - start
        again = 1e3 * timed(lambda s=statistic: np.asarray(s()))
        print(f"  aleator    {name:<28} {again:9.2f} ms   (first time {first:.2f} s)")
    joint = chaospy.Iid(chaospy.Uniform(-1, 1), variables)
    for degree in (2, 3, order) if full else (2,):
        start = time.perf_counter()
        basis = chaospy.generate_expansion(degree, joint)
        polynomial = chaospy.sum(basis * np.random.default_rng(SEED).normal(size=len(basis)))
        built = time.perf_counter() - start
        seconds = timed(lambda p=polynomial: chaospy.Std(p, joint), repeats=1)
        what = f"Std, order {degree} ({len(basis)} terms)"
        print(f"  chaospy    {what:<28} {1e3 * seconds:9.0f} ms   (basis {built:.2f} s)")


if __name__ == "__main__":
    compare_trajectories()
    compare_statistics("--full" in sys.argv[1:])
