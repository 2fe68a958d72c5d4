"""A corpus of bad inputs: calls of the public language with one thing wrong, and what the refusal must name."""

import functools
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import sympy

import aleator as al
from tiny_models import Decay, Gain, gain_problem


class Bad(NamedTuple):
    """A call that has to be refused, and words of which the refusal has to hold one."""

    call: Callable[[], Any]
    received: tuple[str, ...]


class Told(NamedTuple):
    """A value, and by what word a message may name it."""

    value: Any
    word: str


class Thing:
    """An object of nobody's."""

    def __repr__(self) -> str:
        return "<a Thing>"


NOT_NUMBERS: dict[str, Any] = {
    "text": "1.0",
    "dict": {"a": 1.0},
    "bool": True,
    "complex": 1.0 + 2.0j,
    "function": math.sin,
    "object": Thing(),
    "masked": np.ma.masked,
    "nan": math.nan,
}
ENDLESS: dict[str, Any] = {"inf": math.inf, "minus inf": -math.inf}
MANY: dict[str, Any] = {"two numbers": [1.0, 2.0], "nothing in an array": np.zeros(0)}
NUMBER = NOT_NUMBERS | ENDLESS | MANY
POSITIVE = NUMBER | {"zero": 0.0, "negative": -1.5}
WHOLE = NUMBER | {"nothing": None, "fraction": 2.5, "negative": -3}
COUNT = WHOLE | {"zero": 0}
OPTIONAL_COUNT = {name: value for name, value in COUNT.items() if name != "nothing"}
SHARE = POSITIVE | {"one and a half": 1.5, "a per cent": "1%"}
SEARCH = {
    "tolerance": POSITIVE,
    "evaluations": COUNT,
    "seconds": {name: value for name, value in POSITIVE.items() if name != "inf"},
    "seed": WHOLE,
    "polish": {"text": "yes", "one": 1, "nothing": None},
    "progress": {"text": "yes", "nothing": None, "function": math.sin},
}
NAME: dict[str, Any] = {
    "nothing": None,
    "number": 3.5,
    "list": ["x"],
    "bytes": b"x",
    "object": Thing(),
    "function": math.sin,
    "empty": "",
}
NO_OBJECT: dict[str, Any] = {
    "text": "x",
    "number": 3.5,
    "list": [1.0],
    "dict": {"a": 1.0},
    "object": Thing(),
    "bool": True,
}
REQUIRED = NO_OBJECT | {"nothing": None}
MAPPING: dict[str, Any] = {"nothing": None, "text": "x", "number": 3.5, "list": [1.0], "object": Thing()}
FUNCTION: dict[str, Any] = {"nothing": None, "text": "x", "number": 3.5, "list": [1.0]}
VECTOR = NOT_NUMBERS | {"inf": math.inf, "number": 1.0, "four numbers": np.ones(4)}
FILE: dict[str, Any] = {"nothing": None, "number": 3.5, "list": [1.0], "object": Thing(), "missing": "nobody.xml"}
FLAG: dict[str, Any] = {"nothing": None, "text": "yes", "number": 1.0}
EFFECTS: dict[str, Any] = {"nothing": None, "number": 3.5, "numbers": [1.0], "unknown": ["rust"], "text": "rust"}
AXIS = VECTOR | {"zeros": Told(np.zeros(3), "zero")}


def without(values: Mapping[str, Any], *names: str) -> dict[str, Any]:
    """Values without those called `names`."""
    return {name: value for name, value in values.items() if name not in names}


def said(value: Any) -> tuple[str, ...]:
    """The ways in which a message may name a value: as it is written, by its type, size or shape, or by its parts."""
    words = [repr(value), str(value), type(value).__name__]
    if isinstance(value, dict):
        words += [word for part in (*value, *value.values()) for word in said(part)]
    if isinstance(value, list | tuple):
        words += ["none", *(word for part in value for word in said(part))]
    if value is None:
        words += ["none"]
    if isinstance(value, int | float) and not isinstance(value, bool):
        words += [f"{value:g}", str(abs(value)), "shape ()", "received ()", "values ()", "times ()", "of shape ()"]
    if isinstance(value, np.ndarray | list):
        words += [str(np.shape(value)), f"{np.size(value)} "]
    if isinstance(value, str) and not value:
        words = ["''", '""', "empty"]
    if isinstance(value, float) and math.isnan(value):
        words += ["finite"]
    return tuple(word for word in words if word)


# --- What is declared ------------------------------------------------------------------------------------------------

_DISTRIBUTIONS: dict[str, tuple[Callable[..., Any], dict[str, Any], dict[str, Mapping[str, Any]]]] = {
    "Normal": (al.Normal, {"mean": 1.0, "std": 0.1}, {"mean": NUMBER, "std": POSITIVE}),
    "Uniform": (al.Uniform, {"mean": 1.0, "half_width": 0.1}, {"mean": NUMBER, "half_width": POSITIVE}),
    "Uniform.bounds": (al.Uniform.bounds, {"lower": 0.0, "upper": 1.0}, {"lower": NUMBER, "upper": NUMBER}),
    "Beta": (al.Beta, {"alpha": 2.0, "beta": 3.0}, {"alpha": POSITIVE, "beta": POSITIVE, "upper": NUMBER}),
    "Gamma": (al.Gamma, {"shape": 2.0, "scale": 3.0}, {"shape": POSITIVE, "scale": POSITIVE}),
    "LogNormal": (al.LogNormal, {"mean": 2.0, "std": 0.3}, {"mean": POSITIVE, "std": POSITIVE}),
    "Exponential": (al.Exponential, {"mean": 2.0}, {"mean": POSITIVE, "lower": NUMBER}),
    "Gumbel": (al.Gumbel, {"location": 2.0, "scale": 1.0}, {"location": NUMBER, "scale": POSITIVE}),
    "Weibull": (al.Weibull, {"scale": 2.0, "shape": 1.5}, {"scale": POSITIVE, "shape": POSITIVE}),
    "Triangular": (al.Triangular, {"lower": 0.0, "mode": 1.0, "upper": 2.0}, {"lower": NUMBER, "mode": NUMBER}),
    "TruncatedNormal": (al.TruncatedNormal, {"location": 0.0, "scale": 1.0}, {"location": NUMBER, "scale": POSITIVE}),
    "Toleranced": (al.Toleranced, {"nominal": 2.0, "tolerance": 0.1}, {"nominal": NUMBER, "tolerance": POSITIVE}),
}

_CONSTRUCTORS: dict[str, tuple[Callable[..., Any], dict[str, Any], dict[str, Mapping[str, Any]]]] = {
    "Fmu": (al.foreign.Fmu, {}, {"path": NAME}),
    "FmuSimulation": (al.foreign.FmuSimulation, {"grid": al.Grid(1.0, 4)}, {"fmu": REQUIRED}),
    "FmuSystem": (al.foreign.FmuSystem, {}, {"fmu": REQUIRED}),
    "Decision": (
        al.Decision,
        {"initial": 1.0, "lower": 0.0, "upper": 2.0},
        {
            "initial": without(NUMBER, "two numbers", "nothing in an array") | {"nothing": None, "beyond": 3.0},
            "lower": without(NUMBER, "minus inf") | {"nothing": None},
        },
    ),
    "Sample": (al.Sample, {"data": np.linspace(0.0, 1.0, 50)}, {"data": NOT_NUMBERS | {"one number": 1.0}}),
    "Density": (
        al.Density,
        {"function": lambda x: 1.0 + 0.0 * x, "lower": 0.0, "upper": 1.0},
        {"function": FUNCTION, "lower": NUMBER, "upper": NUMBER},
    ),
    "Grid": (al.Grid, {"t_final": 1.0, "steps": 4}, {"t_final": POSITIVE, "steps": COUNT, "t_start": NUMBER}),
    "Expansion": (
        al.Expansion,
        {},
        {
            "order": OPTIONAL_COUNT,
            "index_set": NO_OBJECT,
            "points": without(OPTIONAL_COUNT, "nothing"),
            "fit": NO_OBJECT,
            "tolerance": POSITIVE,
        },
    ),
    "Adaptive": (al.index_sets.Adaptive, {}, {"error": POSITIVE, "budget": COUNT}),
    "HyperbolicCross": (al.index_sets.HyperbolicCross, {}, {"q": SHARE}),
    "Anisotropic": (
        al.index_sets.Anisotropic,
        {"weights": [1.0, 2.0]},
        {"weights": without(NO_OBJECT, "list", "dict")},
    ),
    "MultiElement": (al.MultiElement, {}, {"order": COUNT, "error": POSITIVE, "budget": COUNT}),
    "HammersleyPoints": (al.points.HammersleyPoints, {}, {"count": OPTIONAL_COUNT}),
    "InducedPoints": (al.points.InducedPoints, {}, {"count": OPTIONAL_COUNT}),
    "HaltonPoints": (al.points.HaltonPoints, {}, {"count": OPTIONAL_COUNT}),
    "RandomPoints": (al.points.RandomPoints, {}, {"count": OPTIONAL_COUNT, "seed": WHOLE}),
    "LatinHypercubePoints": (al.points.LatinHypercubePoints, {}, {"count": OPTIONAL_COUNT, "seed": WHOLE}),
    "ChristoffelPoints": (al.points.ChristoffelPoints, {}, {"count": OPTIONAL_COUNT, "seed": WHOLE}),
    "SquaredExponentialCovariance": (al.processes.SquaredExponentialCovariance, {}, {"correlation_time": POSITIVE}),
    "SobolPoints": (al.points.SobolPoints, {}, {"count": OPTIONAL_COUNT, "seed": WHOLE}),
    "GaussPoints": (al.points.GaussPoints, {}, {"count": OPTIONAL_COUNT}),
    "OptimalPoints": (al.points.OptimalPoints, {}, {"count": OPTIONAL_COUNT, "seed": WHOLE}),
    "SmolyakPoints": (al.points.SmolyakPoints, {}, {"level": without(OPTIONAL_COUNT, "zero")}),
    "Tabulated": (
        al.Tabulated,
        {"times": [0.0, 1.0], "values": [0.0, 1.0]},
        {
            "times": without(VECTOR, "four numbers")
            | {"falling": Told([1.0, 0.0], "sample 1"), "three": np.arange(3.0)},
            "values": without(VECTOR, "four numbers") | {"nothing": None},
        },
    ),
    "BSpline": (
        al.BSpline,
        {"free": np.zeros(4)},
        {"free": NOT_NUMBERS | {"inf": math.inf}, "start": NOT_NUMBERS, "degree": COUNT, "knots": NO_OBJECT},
    ),
    "Control": (
        al.Control,
        {"initial": 0.0},
        {
            "initial": without(NOT_NUMBERS, "function") | ENDLESS | {"nothing": None},
            "lower": without(NOT_NUMBERS, "nan") | {"nothing": None, "one": 1.0},
            "upper": NOT_NUMBERS | {"minus one": -1.0},
            "degree": WHOLE | {"two": 2},
        },
    ),
    "PowerSeries": (
        al.PowerSeries,
        {"start": (0.0, 0.0), "end": (1.0, 0.0)},
        {"start": NOT_NUMBERS, "end": NOT_NUMBERS, "middle": NOT_NUMBERS},
    ),
    "Kvaerno5": (al.integrators.Kvaerno5, {}, {"rtol": POSITIVE, "atol": POSITIVE, "max_steps": COUNT}),
    "Tsit5": (al.integrators.Tsit5, {}, {"rtol": POSITIVE, "max_steps": COUNT}),
    "Condensing": (al.solvers.Condensing, {}, {"tolerance": POSITIVE, "max_iterations": COUNT}),
    "FilterSQP": (al.solvers.FilterSQP, {}, {"tolerance": POSITIVE, "max_iterations": COUNT, "radius": POSITIVE}),
    "Simultaneous": (
        al.Simultaneous,
        {"scheme": al.schemes.Radau(3), "error": 1e-6},
        {
            "scheme": NO_OBJECT,
            "error": without(POSITIVE, "nothing") | {"two": 2.0, "tiny": 1e-15},
            "most_stages": OPTIONAL_COUNT | {"no more": 3, "fifty": 50},
            "guess": without(NO_OBJECT, "nothing"),
        },
    ),
    "Radau": (al.schemes.Radau, {}, {"stages": COUNT | {"fifty": 50}}),
    "GaussLegendre": (al.schemes.GaussLegendre, {}, {"stages": COUNT | {"fifty": 50}}),
    "MultipleShooting": (al.schemes.MultipleShooting, {}, {"steps": COUNT}),
    "Ipopt": (al.solvers.Ipopt, {}, {"tolerance": POSITIVE, "max_iterations": COUNT}),
    "InteriorPoint": (al.solvers.InteriorPoint, {}, {"tolerance": POSITIVE, "max_iterations": COUNT}),
    "Slsqp": (al.solvers.Slsqp, {}, {"tolerance": POSITIVE, "max_iterations": COUNT, "max_rounds": COUNT}),
    "CmaEs": (al.solvers.CmaEs, {}, SEARCH | {"population": COUNT | {"three": 3}}),
    "DifferentialEvolution": (al.solvers.DifferentialEvolution, {}, SEARCH | {"population": COUNT | {"four": 4}}),
    "Direct": (al.solvers.Direct, {}, SEARCH),
    "DualAnnealing": (al.solvers.DualAnnealing, {}, SEARCH),
    "NelderMead": (al.solvers.NelderMead, {}, SEARCH),
    "ExponentialCovariance": (
        al.processes.ExponentialCovariance,
        {"correlation_time": 1.0},
        {"correlation_time": POSITIVE},
    ),
    "BandLimitedCovariance": (
        al.processes.BandLimitedCovariance,
        {"f_low": 1.0, "f_high": 2.0},
        {"f_low": without(POSITIVE, "zero"), "f_high": POSITIVE},
    ),
    "RandomProcess": (
        al.processes.RandomProcess,
        {"covariance": al.processes.ExponentialCovariance(1.0), "t_final": 1.0, "std": 1.0, "modes": 2},
        {"covariance": REQUIRED, "t_final": POSITIVE, "std": NUMBER, "mean": NUMBER, "modes": OPTIONAL_COUNT},
    ),
    "Sphere": (al.shapes.Sphere, {"center": np.zeros(3)}, {"center": VECTOR, "radius": NUMBER | {"negative": -1.0}}),
    "Capsule": (
        al.shapes.Capsule,
        {"start": np.zeros(3), "end": np.ones(3)},
        {"start": VECTOR, "end": VECTOR, "radius": NUMBER | {"negative": -1.0}},
    ),
    "Box": (al.shapes.Box, {"center": np.zeros(3), "half_sizes": np.ones(3)}, {"center": VECTOR, "half_sizes": VECTOR}),
    "HalfSpace": (al.shapes.HalfSpace, {"normal": np.ones(3), "offset": 0.0}, {"normal": AXIS, "offset": NUMBER}),
    "Revolute": (
        al.joints.Revolute,
        {"axis": (0.0, 0.0, 1.0)},
        {"axis": AXIS, "damping": NUMBER, "stiffness": NUMBER, "armature": NUMBER},
    ),
    "Prismatic": (al.joints.Prismatic, {"axis": (0.0, 0.0, 1.0)}, {"axis": AXIS, "rest": NUMBER}),
    "Body": (
        al.Body,
        {"name": "arm", "joint": al.joints.Fixed(), "mass": 1.0},
        {
            "name": NAME,
            "parent": without(NAME, "nothing"),
            "joint": REQUIRED,
            "mass": NUMBER | {"negative": -1.0},
            "center": VECTOR,
            "inertia": VECTOR,
        },
    ),
    "foreign.Robot": (
        al.foreign.Robot,
        {"parts": {"arm": al.Body("arm", joint=al.joints.Fixed(), mass=1.0)}, "order": ("arm",)},
        {"parts": MAPPING, "order": {"nothing": (), "another": ("leg",)}},
    ),
    "foreign.read_urdf": (
        al.foreign.read_urdf,
        {"path": "nobody.urdf"},
        {"path": FILE, "floating": FLAG, "leave_out": EFFECTS},
    ),
    "foreign.read_mjcf": (al.foreign.read_mjcf, {"path": "nobody.xml"}, {"path": FILE, "leave_out": EFFECTS}),
    "BodyLoad": (al.BodyLoad, {"body": "arm"}, {"body": NAME, "force": VECTOR, "at": VECTOR}),
    "InverseDynamics": (
        al.InverseDynamics,
        {"model": None, "motion": {}},
        {"model": NO_OBJECT | {"a system": Decay(1.0)}},
    ),
    "ForwardDynamics": (al.ForwardDynamics, {"model": None}, {"model": NO_OBJECT | {"a system": Decay(1.0)}}),
    "HybridDynamics": (al.HybridDynamics, {"model": None, "motion": {}}, {"model": NO_OBJECT}),
    "Assembly": (
        al.Assembly,
        {"dimensions": {"a": 1.0}, "features": {"gap": lambda d, u: d.a}},
        {"dimensions": MAPPING, "unknowns": without(MAPPING, "nothing"), "features": without(MAPPING, "nothing")},
    ),
}

_X, _K = sympy.symbols("x k")
_FUNCTIONALS = (al.path, al.terminal, al.integral, al.rms, al.peak, al.output, al.value)

_LANGUAGE: dict[str, tuple[Callable[..., Any], dict[str, Any], dict[str, Mapping[str, Any]]]] = {
    **{one.__name__: (one, {}, {"#0": NAME}) for one in _FUNCTIONALS},
    "at_most": (
        lambda bound, **a: al.path("x").at_most(bound, **a),
        {"bound": 1.0},
        {"bound": without(NUMBER, "inf"), "sigmas": without(POSITIVE, "zero")},
    ),
    "at_least": (
        lambda bound, **a: al.path("x").at_least(bound, **a),
        {"bound": 1.0},
        {"bound": without(NUMBER, "minus inf"), "sigmas": without(POSITIVE, "zero")},
    ),
    "equals": (lambda value: al.terminal("x").mean.equals(value), {}, {"value": NUMBER}),
    "compared": (
        lambda value: al.terminal("x").mean <= value,
        {},
        {"value": without(NUMBER, "inf") | {"nothing": None}},
    ),
    "added": (lambda value: al.terminal("x").mean + value, {}, {"value": NUMBER | {"nothing": None}}),
    "multiplied": (
        lambda value: value * al.terminal("x").mean,
        {},
        {"value": without(NUMBER, "nothing in an array", "two numbers")},
    ),
    "divided": (lambda value: al.terminal("x").mean / value, {}, {"value": NUMBER | {"zero": 0.0}}),
    "raised": (lambda value: al.terminal("x").mean ** value, {}, {"value": without(NUMBER, "nothing in an array")}),
    **{
        one.__name__: (
            functools.partial(one, al.terminal("x").mean),
            {},
            {"#1": without(NUMBER, "nothing in an array")},
        )
        for one in (al.expressions.maximum, al.expressions.minimum)
    },
    "positive_part": (al.expressions.positive_part, {}, {"#0": without(REQUIRED, "number")}),
    "function of": (al.expressions.function, {}, {"#0": FUNCTION}),
    **{
        f"{one.__name__}, smoothed": (
            functools.partial(one, al.terminal("x").mean, *others),
            {"smoothing": 0.1},
            {"smoothing": without(POSITIVE, "zero")},
        )
        for one, others in (
            (al.expressions.maximum, [1.0]),
            (al.expressions.minimum, [1.0]),
            (al.expressions.positive_part, []),
            (al.objectives.norm, []),
        )
    },
    "Constraint": (
        al.Constraint,
        {"expression": al.terminal("x").mean},
        {"expression": without(REQUIRED, "number"), "upper": NOT_NUMBERS},
    ),
    "quantile": (lambda level: al.terminal("x").quantile(level), {}, {"level": SHARE}),
    "covariance": (
        al.covariance,
        {"first": al.terminal("x"), "second": al.terminal("y")},
        {"first": REQUIRED, "second": REQUIRED},
    ),
    "correlation": (al.correlation, {"first": al.terminal("x"), "second": al.terminal("y")}, {"second": REQUIRED}),
    "norm": (al.objectives.norm, {}, {"#0": without(REQUIRED, "number", "bool")}),
    "effort": (al.objectives.effort, {}, {"#0": NAME}),
    "effort of weights": (lambda weights: al.objectives.effort("x", weights=weights), {}, {"weights": NOT_NUMBERS}),
    "torque_rate": (al.objectives.torque_rate, {}, {"#0": NAME}),
    "power": (al.objectives.power, {}, {"#0": MAPPING}),
    "coefficient_power": (al.objectives.coefficient_power, {}, {"#0": MAPPING}),
    "terminal_mean_error": (
        al.objectives.terminal_mean_error,
        {},
        {"#0": MAPPING | {"texts": {"x": "y"}, "nan": {"x": math.nan}}},
    ),
    "terminal_variance": (al.objectives.terminal_variance, {}, {"#0": NAME}),
    "time_integral": (al.time_integral, {}, {"#0": REQUIRED}),
    "cost_curve": (al.cost.cost_curve, {"name": "x", "curve": lambda x: x}, {"name": NAME, "curve": FUNCTION}),
    "reciprocal": (
        al.cost.reciprocal,
        {"name": "x", "bias": 0.0, "scale": 1.0},
        {"name": NAME, "bias": NUMBER, "scale": NUMBER},
    ),
    "reciprocal_squared": (al.cost.reciprocal_squared, {"name": "x", "bias": 0.0, "scale": 1.0}, {"name": NAME}),
    "reciprocal_power": (
        al.cost.reciprocal_power,
        {"name": "x", "bias": 0.0, "scale": 1.0, "power": 2.0},
        {"power": NUMBER},
    ),
    "exponential": (al.cost.exponential, {"name": "x", "bias": 0.0, "scale": 1.0, "rate": 1.0}, {"rate": NUMBER}),
    "parameter": (al.parameter, {}, {"unit": without(NAME, "empty")}),
    "toleranced": (al.toleranced, {}, {"#0": NAME | {"no tolerance": "a bolt"}}),
    "correlated": (
        al.correlated,
        {"distributions": {"a": al.Normal(0.0, 1.0), "b": al.Normal(0.0, 1.0)}, "correlations": {("a", "b"): 0.5}},
        {
            "distributions": MAPPING | {"numbers": {"a": 1.0, "b": 2.0}},
            "correlations": {
                **MAPPING,
                **{
                    f"of {name}": {("a", "b"): value}
                    for name, value in (SHARE | {"unknown": 0.5}).items()
                    if name not in ("unknown", "zero")
                },
            },
        },
    ),
    "total": (al.processes.total, {}, {"#0": REQUIRED}),
    "signal": (al.processes.signal, {}, {"#0": FUNCTION}),
    "fit_control_points": (
        al.fit_control_points,
        {"path": np.linspace(0.0, 1.0, 20), "free": 4},
        {"path": without(NOT_NUMBERS, "function"), "free": COUNT, "duration": POSITIVE},
    ),
    "distance": (
        al.shapes.distance,
        {"first": al.shapes.Sphere(np.zeros(3)), "second": al.shapes.Sphere(np.ones(3))},
        {"first": REQUIRED, "second": REQUIRED},
    ),
    "link_distances": (
        al.shapes.link_distances,
        {"links": [al.shapes.Sphere(np.zeros(3))] * 3},
        {"links": REQUIRED, "apart": COUNT},
    ),
    "smallest": (
        al.shapes.smallest,
        {"distances": np.ones(3)},
        {"distances": without(NOT_NUMBERS, "bool", "nan"), "sharpness": POSITIVE},
    ),
    "openmdao_component": (al.foreign.openmdao_component, {}, {"#0": REQUIRED}),
    "openmdao_component of a problem": (
        lambda declared: al.foreign.openmdao_component(gain_problem(), declared=declared),
        {},
        {"declared": {"text": "yes", "one": 1, "nothing": None}},
    ),
    "from_sympy": (
        al.foreign.from_sympy,
        {"rates": {_X: -_K * _X}, "numbers": {_K: 1.0}},
        {
            "rates": MAPPING | {"of a text": {"x": 1.0}},
            "numbers": MAPPING | {"of a text": {"k": 1.0}, **{f"of {a}": {_K: b} for a, b in NUMBER.items()}},
            "mass_matrix": without(NO_OBJECT, "nothing"),
            "outputs": without(MAPPING, "nothing") | {"a text in it": {"y": "x"}},
            "start": without(MAPPING, "nothing") | {"of a text": {"x": 1.0}, "a text in it": {_X: "1"}},
            "units": without(MAPPING, "nothing") | {"of a stranger": {"stranger": "m"}},
        },
    ),
    "from_sympy_formulas": (
        al.foreign.from_sympy_formulas,
        {"outputs": {"y": 2 * _K}, "numbers": {_K: 1.0}},
        {"outputs": MAPPING | {"a text in it": {"y": "x"}}, "numbers": MAPPING, "units": without(MAPPING, "nothing")},
    ),
    **{
        one.__name__: (one, {"numbers": {}}, {"#0": REQUIRED})
        for one in (al.foreign.from_kane, al.foreign.from_lagrange)
    },
    "deterministic": (al.deterministic, {}, {"#0": REQUIRED}),
    "uncertain": (al.uncertain, {}, {"#0": REQUIRED}),
    "actuation_of": (al.actuation_of, {"q": np.zeros(1)}, {"model": REQUIRED}),
}


# --- What is asked of a problem or a solution ------------------------------------------------------------------------

TWO = {"a": al.Normal(0.0, 1.0), "b": al.Uniform(0.0, half_width=1.0)}


def product(at: Any) -> Any:
    """A model of two inputs."""
    return at["a"] * at["b"]


problem = functools.cache(gain_problem)
SAMPLING = {"samples": COUNT, "seed": WHOLE}


@functools.cache
def solution() -> al.Solution:
    """A solution of a tiny problem."""
    return al.solve(problem())


class OfSolution:
    """A function of the tiny problem's solution, which is solved at the first use."""

    def __init__(self, function: Callable[..., Any]):
        self.function = function

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return self.function(solution(), *arguments, **named)


_STUDIES: dict[str, tuple[Callable[..., Any], dict[str, Any], dict[str, Mapping[str, Any]]]] = {
    "solve": (
        lambda **a: al.solve(problem(), **a),
        {},
        {
            "solver": NO_OBJECT,
            "warm_start": NO_OBJECT,
            "executor": NO_OBJECT,
            "deterministic_first": without(NO_OBJECT, "bool"),
            "start": without(NO_OBJECT, "dict")
            | {
                "unknown": {"nobody": 1.0},
                "beyond": {"gain": 99.0},
                "text in it": {"gain": "x"},
                "shape": {"gain": [1.0, 2.0]},
            },
            "between": without(OPTIONAL_COUNT, "zero"),
            "accuracy": POSITIVE,
        },
    ),
    "solve itself": (al.solve, {}, {"#0": REQUIRED}),
    "cross_check": (
        lambda **a: al.cross_check(problem(), **a),
        {},
        {
            "first": REQUIRED,
            "second": NO_OBJECT,
            "tolerance": POSITIVE,
            "solvers": {"one": (None,), "no tuple": al.solvers.Ipopt(), "names": ("ipopt", None), "text": "ab"},
        },
    ),
    "cross_check itself": (al.cross_check, {}, {"#0": REQUIRED}),
    "validate": (OfSolution(al.validate), {}, SAMPLING | {"batch": COUNT, "executor": NO_OBJECT}),
    "validate itself": (al.validate, {}, {"#0": REQUIRED}),
    "rare_violation": (
        OfSolution(al.rare_violation),
        {},
        SAMPLING | {"names": without(NAME, "nothing", "bytes") | {"unknown": "nobody"}},
    ),
    "rare_violation itself": (al.rare_violation, {}, {"#0": REQUIRED}),
    "calibrate": (
        lambda **a: al.calibrate(problem(), **({"names": "response"} | a)),
        {},
        SAMPLING
        | {
            "names": NAME | {"unknown": "nobody"},
            "target": SHARE,
            "precision": POSITIVE,
            "max_trials": COUNT,
            "solver": NO_OBJECT,
            "executor": NO_OBJECT,
        },
    ),
    "calibrate itself": (al.calibrate, {"names": "x"}, {"problem": REQUIRED}),
    "pareto": (
        lambda **a: al.pareto(problem(), **({"bound": "response", "values": [1.0]} | a)),
        {},
        {"bound": NAME | {"unknown": "nobody"}, "values": NOT_NUMBERS | {"none": []}, "solver": NO_OBJECT},
    ),
    "pareto itself": (al.pareto, {"bound": "x", "values": [1.0]}, {"problem": REQUIRED}),
    "multistart": (
        lambda **a: al.multistart(problem(), **a),
        {},
        {"starts": without(COUNT, "nothing"), "spread": POSITIVE, "seed": WHOLE, "solver": NO_OBJECT},
    ),
    "multistart itself": (al.multistart, {}, {"problem": REQUIRED}),
    "trade_off": (
        lambda **a: al.trade_off(
            problem(), **({"wishes": {"one": al.value("gain"), "two": -1.0 * al.value("gain")}} | a)
        ),
        {},
        {
            "wishes": {
                "text": "x",
                "number": 3.5,
                "one": {"one": al.value("gain")},
                "numbers": {"one": 1.0, "two": 2.0},
                "unnamed": {1: al.value("gain"), 2: al.value("gain")},
            },
            "points": without(COUNT, "nothing") | {"one": 1},
            "executor": NO_OBJECT,
            "method": {"unknown": "best", "nothing": None, "number": 3.5},
            "starts": without(COUNT, "nothing"),
            "evaluations": without(COUNT, "nothing"),
            "seed": without(WHOLE, "nothing"),
            "solver": without(NO_OBJECT, "nothing"),
            "transcription": REQUIRED,
            "progress": {"text": "yes", "nothing": None},
        },
    ),
    "trade_off itself": (al.trade_off, {"wishes": {}}, {"problem": REQUIRED}),
    "conflict": (
        lambda **a: al.conflict(problem(), **a),
        {},
        {"solver": without(NO_OBJECT, "nothing"), "progress": {"text": "yes", "nothing": None}},
    ),
    "harden": (
        lambda **a: al.harden(problem(), **a),
        {},
        {
            "weight": POSITIVE,
            "factor": POSITIVE | {"one": 1.0},
            "most": without(COUNT, "nothing"),
            "tolerance": POSITIVE,
            "exact": {"text": "yes", "nothing": None, "number": 3.5},
            "solver": without(NO_OBJECT, "nothing"),
            "transcription": REQUIRED,
            "progress": {"text": "yes", "nothing": None},
        },
    ),
    "harden itself": (al.harden, {}, {"problem": REQUIRED}),
    "validate_all": (al.validate_all, {}, {"designs": REQUIRED}),
    "examine": (al.examine, {}, {"subject": REQUIRED}),
    "conflict itself": (al.conflict, {}, {"problem": REQUIRED}),
    "portfolio": (
        lambda **a: al.portfolio(problem(), **a),
        {},
        {
            "starts": without(COUNT, "nothing"),
            "search": without(NO_OBJECT, "nothing"),
            "solver": NO_OBJECT,
            "seed": WHOLE,
            "executor": NO_OBJECT,
            "progress": {"text": "yes", "nothing": None},
        },
    ),
    "portfolio itself": (al.portfolio, {}, {"problem": REQUIRED}),
    "Study": (
        lambda **a: al.Study(problem(), **a),
        {},
        {
            "title": without(NAME, "empty"),
            "samples": without(COUNT, "nothing") | {"one": 1},
            "seed": WHOLE,
            "points": without(COUNT, "nothing") | {"one": 1},
            "sweeps": {"unknown": {"nobody": [1.0]}, "texts": {"response": "x"}, "number": 3.5},
            "wishes": {"number": 3.5, "text": "x", "one": {"one": al.value("gain")}},
            "solver": without(NO_OBJECT, "nothing"),
            "transcription": REQUIRED,
            "workers": OPTIONAL_COUNT,
        },
    ),
    "Study itself": (al.Study, {}, {"designs": REQUIRED}),
    "journal": (lambda folder: al.journal(folder).__enter__(), {}, {"folder": without(REQUIRED, "text")}),
    "load": (al.load, {}, {"folder": REQUIRED}),
    "workers": (al.workers, {}, {"count": OPTIONAL_COUNT}),
    "with_bound": (lambda *a: problem().with_bound("response", *a), {}, {"#0": NOT_NUMBERS}),
    "soft": (
        lambda *a, weight=1.0, **b: al.soft(problem(), *a, weight=weight, **b),
        {},
        {"#0": NAME, "weight": POSITIVE, "exact": {"text": "yes", "one": 1, "nothing": None}},
    ),
    "soft exact": (
        lambda **a: al.soft(problem(), weight=1.0, exact=True, **a),
        {},
        {"most": without(POSITIVE, "nothing")},
    ),
    "soft of": (functools.partial(al.soft, weight=1.0), {}, {"#0": REQUIRED}),
    "with_sigmas": (lambda *a: problem().with_sigmas("response", *a), {}, {"#0": POSITIVE}),
    "expand": (
        al.expand,
        {"function": product, "model": TWO},
        {
            "function": FUNCTION,
            "expansion": NO_OBJECT,
            "model": {"no distribution": Told({"a": 1.0, "b": 2.0}, "nothing in the model is uncertain")},
        },
    ),
    "BlackBox": (
        al.foreign.BlackBox,
        {"function": product},
        {
            "function": FUNCTION,
            "executor": NO_OBJECT,
            "retries": WHOLE,
            "drop": without(NUMBER, "nothing in an array") | {"negative": -0.1, "half": 0.5},
            "journal": {"number": 3.5, "list": ["x"], "object": Thing(), "function": math.sin, "empty": ""},
        },
    ),
    "Command": (
        al.foreign.Command,
        {"arguments": ["python", "{a}"]},
        {
            "arguments": {"nothing": None, "text": "python {a}", "number": 3.5, "numbers": [1.0], "none": []},
            "input_file": without(NAME, "nothing") | {"in a folder": "in/x.json"},
            "output_file": without(NAME, "nothing") | {"in a folder": "out/x.json"},
            "time_limit": without(POSITIVE, "nothing"),
        },
    ),
    "Isolated": (
        al.foreign.Isolated,
        {"function": product},
        {"function": FUNCTION, "time_limit": without(POSITIVE, "nothing")},
    ),
    "ask": (
        al.foreign.ask,
        {"model": TWO},
        {"model": {"no distribution": {"a": 1.0}}, "expansion": NO_OBJECT},
    ),
    "tell": (
        lambda responses, **others: al.foreign.ask(TWO).tell(responses, **others),
        {"responses": {"y": np.zeros(30)}},
        {
            "responses": {"nothing": None, "number": 3.5, "object": Thing(), "file": "nobody.csv", "few": [1.0, 2.0]},
            "drop": without(NUMBER, "nothing in an array") | {"negative": -0.1, "half": 0.5},
        },
    ),
    "monte_carlo": (
        al.references.monte_carlo,
        {"function": product, "model": TWO},
        {"function": FUNCTION} | SAMPLING | {"batch": COUNT, "executor": NO_OBJECT},
    ),
    "quasi_monte_carlo": (
        al.references.quasi_monte_carlo,
        {"function": product, "model": TWO},
        {"function": FUNCTION, "replicates": COUNT, "executor": NO_OBJECT} | SAMPLING,
    ),
    "sobol_indices": (
        al.references.sobol_indices,
        {"function": product, "model": TWO},
        {"function": FUNCTION} | SAMPLING,
    ),
    "linearise": (al.references.linearise, {"function": product, "model": TWO}, {"function": FUNCTION}),
    "second_order": (al.references.second_order, {"function": product, "model": TWO}, {"function": FUNCTION}),
    "tolerance_analysis": (
        al.tolerance_analysis,
        {"model": TWO, "output": product, "upper": 9.0},
        {"output": {"nothing": None, "number": 3.5}, "lower": NOT_NUMBERS, "expansion": NO_OBJECT},
    ),
    "galerkin": (
        al.galerkin,
        {"system": Decay(al.Normal(1.0, 0.1)), "grid": al.Grid(1.0, 2)},
        {
            "system": REQUIRED,
            "grid": REQUIRED,
            "expansion": NO_OBJECT,
            "inputs": without(NO_OBJECT, "dict"),
            "integrator": NO_OBJECT,
        },
    ),
    "simulate": (
        al.simulate,
        {"system": Decay(1.0), "grid": al.Grid(1.0, 2)},
        {
            "system": REQUIRED,
            "grid": REQUIRED,
            "inputs": NO_OBJECT,
            "integrator": NO_OBJECT,
            "only": {"number": 3.5, "unknown": ["nobody"], "text": "x"},
        },
    ),
    "Problem": (
        al.Problem,
        {
            "system": Gain(al.Decision(0.5, 0.0, 10.0), al.Normal(1.0, 0.1)),
            "grid": al.Grid(1.0, 1),
            "minimize": al.terminal("loss").mean,
        },
        {
            "system": REQUIRED,
            "grid": REQUIRED,
            "minimize": without(REQUIRED, "number")
            | {"unknown": Told(al.terminal("nobody").mean, "nobody"), "a path": al.path("loss").mean},
            "subject_to": REQUIRED | {"unknown": Told([al.terminal("nobody").mean <= 1.0], "nobody")},
            "inputs": without(NO_OBJECT, "dict") | {"unknown": {"nobody": al.Tabulated([0.0, 1.0], [0.0, 1.0])}},
            "expansion": NO_OBJECT,
            "integrator": NO_OBJECT,
            "decisions": {
                "number": 3.5,
                "list": ["x"],
                "numbers": {"slack": 1.0},
                "taken": Told({"gain": al.Decision(1.0)}, "gain"),
            },
        },
    ),
    "threads": (al.threads, {}, {"count": OPTIONAL_COUNT}),
    "compilation_cache": (al.compilation_cache, {}, {"folder": without(NAME, "nothing") | {"bool": True}}),
    "report": (
        lambda **a: al.report(**({"solutions": solution(), "path": "never.html"} | a)),
        {},
        {
            "solutions": REQUIRED,
            "evidence": NO_OBJECT,
            "fronts": NO_OBJECT,
            "path": {"nothing": None, "number": 3.5, "too long": Told("x" * 400 + ".html", "xxx…")},
        },
    ),
}


# --- Written ones ----------------------------------------------------------------------------------------------------


def system(**methods: Any) -> Any:
    """A system `x' = -x` with some methods or fields other than they should be."""
    usual = {
        "states": ("x",),
        "rhs": lambda self, t, z: (-z.x,),
        "outputs": lambda self, t, z: {"x": z.x},
    }
    return type("Odd", (al.System,), usual | methods)()


def algebraic(**methods: Any) -> Any:
    """An algebraic system `x = 1` with some methods other than they should be."""
    usual = {
        "unknowns": ("x",),
        "guess": lambda self: {"x": 1.0},
        "residual": lambda self, z: (z.x - 1.0,),
        "outputs": lambda self, z: {"x": z.x},
    }
    return type("Odd", (al.AlgebraicSystem,), usual | methods)()


_STATEFUL_BODIES: dict[str, tuple[Callable[[Any], Any], tuple[str, ...]]] = {
    "np.sin": (np.sin, ("jnp",)),
    "math.sin": (math.sin, ("jnp",)),
    "float": (float, ("jnp", "float")),
    "int": (int, ("jnp", "int")),
    "item": (lambda x: x.item(), ("jnp", "item")),
    "np.asarray": (np.asarray, ("jnp",)),
    "tolist": (lambda x: x.tolist(), ("jnp",)),
    "if": (lambda x: 1.0 if x > 0 else x, ("jnp.where",)),
    "max": (lambda x: max(x, 0.0), ("jnp",)),
    "range": (lambda x: sum(range(x)), ("Odd",)),
    "format": (lambda x: float(f"{x:.3f}"), ("Odd",)),
    "wrong name": (lambda x: x.nobody, ("nobody",)),
    "unknown name": (lambda x: nobody, ("nobody",)),
    "text": (lambda x: "fast", ("fast", "str")),
    "nothing": (lambda x: None, ("None",)),
    "complex": (lambda x: x * 1j, ("complex",)),
    "masked": (lambda x: np.ma.masked, ("masked", "Masked")),
    "index": (lambda x: x[3], ("Odd",)),
    "division by zero": (lambda x: x * (1 / 0), ("zero",)),
    "list": (lambda x: [x, "y"], ("list", "y")),
    "shape": (lambda x: x * np.ones(2), ("(2,)", "received 2")),
    "matrices": (lambda x: np.ones((2, 3)) @ (np.ones(2) * x), ("Odd",)),
    "dict": (lambda x: {"x": x}, ("{'x':",)),
    "function": (lambda x: math.sin, ("sin", "builtin_function_or_method")),
}


def _bodies() -> Iterator[tuple[str, Bad]]:
    for name, (body, words) in _STATEFUL_BODIES.items():
        yield (
            f"rhs: {name}",
            Bad(lambda body=body: al.simulate(system(rhs=lambda self, t, z: (body(z.x),)), al.Grid(1.0, 1)), words),
        )
        if name != "shape":  # an output may have any
            yield (
                f"outputs: {name}",
                Bad(
                    lambda body=body: al.simulate(system(outputs=lambda self, t, z: {"x": body(z.x)}), al.Grid(1.0, 1)),
                    words,
                ),
            )
        yield (
            f"residual: {name}",
            Bad(lambda body=body: al.simulate(algebraic(residual=lambda self, z: (body(z.x),))), words),
        )
        if name in ("np.sin", "float", "if", "item"):
            yield (
                f"declared: {name}",
                Bad(
                    lambda body=body: al.Problem(
                        system(rhs=lambda self, t, z: (body(z.x),)),
                        grid=al.Grid(1.0, 1),
                        minimize=al.terminal("x").mean,
                    ),
                    words,
                ),
            )
            yield (
                f"expanded: {name}",
                Bad(
                    lambda body=body: al.expand(lambda at: body(at["a"]), TWO, al.Expansion(1)), (*words[:1], "traced")
                ),
            )


def _simulated(**methods: Any) -> Callable[[], Any]:
    return lambda: al.simulate(system(**methods), al.Grid(1.0, 1))


_WRITTEN: dict[str, Bad] = {
    "states: nothing": Bad(_simulated(states=None), ("None",)),
    "algebraic: nothing": Bad(_simulated(algebraic=None), ("None",)),
    "algebraic: text": Bad(_simulated(algebraic="y"), ("'y'",)),
    "algebraic: a state": Bad(_simulated(algebraic=("x",)), ("x",)),
    "states: text": Bad(_simulated(states="x"), ("'x'",)),
    "states: twice": Bad(_simulated(states=("x", "x"), rhs=lambda self, t, z: (1.0, 1.0)), ("x",)),
    "states: no name": Bad(_simulated(states=("2x",)), ("2x",)),
    "states: keyword": Bad(_simulated(states=("class",)), ("class",)),
    "states: underscore": Bad(_simulated(states=("_x",)), ("_x",)),
    "states: number": Bad(_simulated(states=(1,)), ("1",)),
    "rhs: too many rates": Bad(_simulated(rhs=lambda self, t, z: (z.x, z.x)), ("2",)),
    "rhs: no tuple": Bad(_simulated(rhs=lambda self, t, z: -z.x), ("rhs",)),
    "rhs: no arguments": Bad(_simulated(rhs=lambda self: (1.0,)), ("1 positional",)),
    "rhs: an input not given": Bad(_simulated(rhs=lambda self, t, z, force: (force,)), ("force",)),
    "outputs: no dict": Bad(_simulated(outputs=lambda self, t, z: z.x), ("outputs",)),
    "outputs: named by a number": Bad(_simulated(outputs=lambda self, t, z: {1: z.x}), ("1",)),
    "outputs: of no entries": Bad(_simulated(outputs=lambda self, t, z: {"x": np.zeros(0)}), ("(0,)",)),
    "initial: unknown": Bad(_simulated(initial=lambda self: {"nobody": 1.0}), ("nobody",)),
    "initial: text": Bad(_simulated(initial=lambda self: {"x": "fast"}), ("fast",)),
    "initial: nothing": Bad(_simulated(initial=lambda self: {"x": None}), ("None",)),
    "initial: no dict": Bad(_simulated(initial=lambda self: 3.0), ("3.0",)),
    "initial: nan": Bad(_simulated(initial=lambda self: {"x": math.nan}), ("nan",)),
    "initial: masked": Bad(_simulated(initial=lambda self: {"x": np.ma.masked}), ("masked", "Masked")),
    "initial: complex": Bad(_simulated(initial=lambda self: {"x": 1j}), ("1j", "complex")),
    "guess: text": Bad(lambda: al.simulate(algebraic(guess=lambda self: {"x": "fast"})), ("fast",)),
    "guess: no dict": Bad(lambda: al.simulate(algebraic(guess=lambda self: 3.0)), ("3.0",)),
    "guess: nan": Bad(lambda: al.simulate(algebraic(guess=lambda self: {"x": math.nan})), ("nan",)),
    "field: text": Bad(lambda: al.simulate(Decay("fast"), al.Grid(1.0, 1)), ("'str'",)),
    "field: nothing": Bad(lambda: al.simulate(Decay(None), al.Grid(1.0, 1)), ("None",)),
    "field: masked": Bad(lambda: al.simulate(Decay(np.ma.masked), al.Grid(1.0, 1)), ("masked", "Masked")),
    "field: of a problem: masked": Bad(lambda: gain_problem(theta=np.ma.masked), ("masked", "Masked")),
    "field: of a problem: text": Bad(lambda: gain_problem(theta="fast"), ("Gain.outputs",)),
    "field: of a problem: nan": Bad(lambda: gain_problem(theta=math.nan), ("nan",)),
    "inverse dynamics: algebraic": Bad(lambda: al.InverseDynamics(algebraic(), motion={}), ("Odd",)),
    "forward dynamics: algebraic": Bad(lambda: al.ForwardDynamics(algebraic()), ("Odd",)),
    "a shared name": Bad(lambda: al.Normal(0.0, 1.0).shared(3), ("3",)),
    "a shared name of a decision": Bad(lambda: al.Decision(0.0).shared(None), ("None",)),
    "a misspelt argument": Bad(lambda: gain_problem().named("nobody"), ("nobody",)),
    "a masked array of data": Bad(
        lambda: al.Sample(np.ma.masked_array(np.linspace(0.0, 1.0, 50), [True] + [False] * 49)), ("masked", "Masked")
    ),
    "a masked table": Bad(
        lambda: al.Tabulated([0.0, 1.0, 2.0], np.ma.masked_array([0.0, 1.0, 2.0], [0, 1, 0])), ("masked", "Masked")
    ),
}


def _file(folder: Any, name: str, content: bytes) -> Any:
    path = folder / name
    path.write_bytes(content)
    return path


def files(folder: Any) -> dict[str, Bad]:
    """Files that are no tables of a signal."""

    def read(path: Any, time: Any = "t", value: Any = "x") -> Any:
        return al.Tabulated.from_csv(path, time, value)

    return {
        "csv: missing": Bad(lambda: read(folder / "nobody.csv"), ("nobody.csv",)),
        "csv: a folder": Bad(lambda: read(folder), (folder.name,)),
        "csv: not UTF-8": Bad(lambda: read(_file(folder, "a.csv", b"t,h\xf6he\n0,1\n1,2\n")), ("UTF-8",)),
        "csv: bytes": Bad(lambda: read(_file(folder, "b.csv", bytes(range(256)))), ("b.csv",)),
        "csv: a column twice": Bad(lambda: read(_file(folder, "c.csv", b"t,x,x\n0,1,2\n1,2,3\n")), ("x",)),
        "csv: empty": Bad(lambda: read(_file(folder, "d.csv", b"")), ("d.csv",)),
        "csv: no rows": Bad(lambda: read(_file(folder, "e.csv", b"t,x\n")), ("e.csv",)),
        "csv: words": Bad(lambda: read(_file(folder, "f.csv", b"t,x\n0,fast\n1,slow\n")), ("fast",)),
        "csv: ragged": Bad(lambda: read(_file(folder, "g.csv", b"t,x\n0,1\n1\n")), ("g.csv",)),
        "csv: a number": Bad(lambda: read(3.5), ("3.5",)),
        "csv: nothing": Bad(lambda: read(None), ("None",)),
    }


def _generated() -> Iterator[tuple[str, Bad]]:
    for who, (function, usual, arguments) in (_DISTRIBUTIONS | _CONSTRUCTORS | _LANGUAGE | _STUDIES).items():
        for argument, values in arguments.items():
            for name, value in values.items():
                value, words = (value.value, (value.word,)) if isinstance(value, Told) else (value, said(value))
                if argument.startswith("#"):
                    yield f"{who}: {name}", Bad(functools.partial(function, value, **usual), words)
                else:
                    yield (
                        f"{who}({argument}): {name}",
                        Bad(functools.partial(function, **usual | {argument: value}), words),
                    )


CORPUS: dict[str, Bad] = {**dict(_generated()), **dict(_bodies()), **_WRITTEN}
