"""Programs with published or closed-form optima, each with its exact derivatives."""

import numpy as np

from aleator.nlp import Evaluation, NonlinearProgram

INF = np.inf


def program(evaluate, start, lower=None, upper=None, rows=(), variable_scale=None, constraint_scale=None):
    """Fills in what most programs leave out; `rows` are pairs of bounds."""
    n, m = len(start), len(rows)
    bounds = np.array(rows, dtype=float).reshape(m, 2)
    return NonlinearProgram(
        evaluate=evaluate,
        start=np.array(start, dtype=float),
        lower=np.full(n, -INF) if lower is None else np.array(lower, dtype=float),
        upper=np.full(n, INF) if upper is None else np.array(upper, dtype=float),
        constraint_lower=bounds[:, 0],
        constraint_upper=bounds[:, 1],
        constraint_scale=np.ones(m) if constraint_scale is None else np.array(constraint_scale, dtype=float),
        variable_scale=np.ones(n) if variable_scale is None else np.array(variable_scale, dtype=float),
    )


def evaluation(objective, gradient, constraints=(), jacobian=()):
    gradient, constraints = np.array(gradient, dtype=float), np.array(constraints, dtype=float)
    return Evaluation(objective, gradient, constraints, np.array(jacobian, dtype=float).reshape(-1, gradient.size))


def _rosenbrock(x):
    gap = x[1] - x[0] ** 2
    return 100 * gap**2 + (1 - x[0]) ** 2, [-400 * x[0] * gap - 2 * (1 - x[0]), 200 * gap]


def rosenbrock():
    return program(lambda x: evaluation(*_rosenbrock(x)), [-1.2, 1.0])


def hs15():
    def evaluate(x):
        return evaluation(*_rosenbrock(x), [x[0] * x[1], x[0] + x[1] ** 2], [[x[1], x[0]], [1, 2 * x[1]]])

    return program(evaluate, [-2.0, 1.0], upper=[0.5, INF], rows=[(1, INF), (0, INF)])


def hs35():
    hessian = np.array([[4.0, 2, 2], [2, 4, 0], [2, 0, 2]])
    linear = np.array([-8.0, -6, -4])

    def evaluate(x):
        return evaluation(
            9 + linear @ x + x @ hessian @ x / 2, linear + hessian @ x, [x[0] + x[1] + 2 * x[2]], [[1, 1, 2]]
        )

    return program(evaluate, [0.5, 0.5, 0.5], lower=np.zeros(3), rows=[(-INF, 3)])


def hs71(product_at_least=25.0, squares=40.0):
    def evaluate(x):
        total = x[0] + x[1] + x[2]
        gradient = [x[3] * (x[0] + total), x[0] * x[3], x[0] * x[3] + 1, x[0] * total]
        product = np.prod(x)
        return evaluation(x[0] * x[3] * total + x[2], gradient, [product, x @ x], [product / x, 2 * x])

    return program(evaluate, [1.0, 5, 5, 1], np.ones(4), np.full(4, 5.0), [(product_at_least, INF), (squares, squares)])


def hs28():
    def evaluate(x):
        a, b = x[0] + x[1], x[1] + x[2]
        return evaluation(a**2 + b**2, [2 * a, 2 * (a + b), 2 * b], [x @ [1, 2, 3]], [[1, 2, 3]])

    return program(evaluate, [-4.0, 1, 1], rows=[(1, 1)])


def disc(points=3001):
    """The point of the unit disc nearest to (2, 2), the disc given by its tangents in the first quadrant."""
    angle = np.linspace(0, np.pi / 2, points)
    tangents = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return program(
        lambda x: evaluation(((x - 2) ** 2).sum(), 2 * (x - 2), tangents @ x, tangents),
        [0.0, 0.3],
        rows=[(-INF, 1)] * points,
    )


def coope_watson(points=3000):
    """Semi-infinite problem 1 of Watson 1983: a polynomial in t, nonlinear in x, at most 0 on [0, 1].

    At the optimum x1 = -3/4 the constraint binds at t = 0 only, where it reads 1 + x2 - x2² <= 0.
    """
    t = np.linspace(0, 1, points)

    def evaluate(x):
        bracket = 1 - x[0] ** 2 * t**2
        rows = bracket**2 - x[0] * t**2 - x[1] ** 2 + x[1]
        jacobian = np.stack([-4 * x[0] * t**2 * bracket - t**2, np.full(points, 1 - 2 * x[1])], axis=1)
        return evaluation(x[0] ** 2 / 3 + x[1] ** 2 + x[0] / 2, [2 * x[0] / 3 + 0.5, 2 * x[1]], rows, jacobian)

    return program(evaluate, [-0.2, -1.0], rows=[(-INF, 0)] * points)


def folded(curve, start):
    """The largest `x + y` for which `y + 2 |x - y**(1 + curve)| <= 1`: at (1, 1), where the limit has its kink.

    Of the limits `y ± 2 (x - y**(1 + curve)) <= 1` both hold there, with multipliers of 5/4 and 3/4 on the line, of 7/4
    and 5/4 on the parabola.
    """

    def evaluate(x):
        away, side = x[0] - x[1] ** (1 + curve), np.array([1.0, -(1 + curve) * x[1] ** curve])
        row = np.array([0.0, 1.0]) + 2 * np.sign(away) * side
        return evaluation(-x[0] - x[1], [-1, -1], [x[1] + 2 * abs(away)], [row])

    return program(evaluate, start, lower=[-3.0, 0], upper=[3.0, 3], rows=[(-INF, 1)])
