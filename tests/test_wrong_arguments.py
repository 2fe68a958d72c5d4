"""Every argument of every public name is refused in one sentence if it is wrong: nothing is accepted without a word."""

import contextlib
import enum
import functools
import inspect
import math
import os
import typing
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import jaxtyping
import numpy as np
import pytest
import sympy
import sympy.physics.mechanics

import aleator as al
from aleator._core import arrays, border
from test_public_names import TOPICS
from zoo import STRESS, Crane, Decay, Pendulum, bar_problem, oscillator_problem

LONGEST = 400


class Stranger:
    """An object that no argument takes."""

    def __repr__(self) -> str:
        return "<a Stranger>"


# Wrong values, and the words of an annotation by which one may be right, or is checked where it is used.
WRONG: dict[str, tuple[Any, tuple[str, ...]]] = {
    "a stranger": (Stranger(), ()),
    "not a number": (math.nan, ("Callable", "Mapping", "dict")),
    "a text": ("wrong", ("str", "Path", "Literal")),
}

_TWO = {"a": al.Normal(0.0, 1.0), "b": al.Uniform(0.0, half_width=1.0)}
_K, _X = sympy.symbols("k x")


@functools.cache
def solution() -> al.Solution:
    return al.solve(bar_problem())


def solutions() -> list[al.Solution]:
    return [solution()]


def _kane() -> Any:
    mechanics = sympy.physics.mechanics
    q, u = mechanics.dynamicsymbols("q u")
    frame, point = mechanics.ReferenceFrame("N"), mechanics.Point("P")
    point.set_vel(frame, u * frame.x)
    method = mechanics.KanesMethod(frame, q_ind=[q], u_ind=[u], kd_eqs=[q.diff() - u])
    method.kanes_equations([mechanics.Particle("block", point, _K)], [(point, -_K * q * frame.x)])
    return method


def _lagrange() -> Any:
    q = sympy.physics.mechanics.dynamicsymbols("q")
    method = sympy.physics.mechanics.LagrangesMethod(q.diff() ** 2 - _K * q**2, [q])
    method.form_lagranges_equations()
    return method


# Right values of arguments without a default, by the names that they have everywhere; functions give costly ones.
USUAL: dict[str, Any] = {
    "Q": np.eye(2),
    "R": 1.0,
    "arguments": ["python", "{a}"],
    "axis": (0.0, 0.0, 1.0),
    "bias": 0.0,
    "body": "arm",
    "bound": "stress",
    "center": np.zeros(3),
    "child": "arm",
    "correlation_time": 1.0,
    "correlations": {("a", "b"): 0.5},
    "costs": {"a": (0.0, 1.0)},
    "count": 2,
    "covariance": al.processes.ExponentialCovariance(1.0),
    "curve": lambda x: x,
    "data": np.linspace(0.0, 1.0, 50),
    "designs": bar_problem,
    "dimensions": {"a": 1.0},
    "distances": np.ones(3),
    "distributions": _TWO,
    "end": np.ones(3),
    "event": "floor",
    "expression": al.output("stress").mean,
    "expressions": al.output("stress").mean,
    "f_high": 2.0,
    "f_low": 1.0,
    "first": al.output("stress"),
    "folder": "nowhere",
    "free": np.zeros(4),
    "function": lambda at: at["a"] * at["b"],
    "gains": 1.0,
    "grid": al.Grid(1.0, 2),
    "half_gap": 1.0,
    "half_sizes": np.ones(3),
    "initial": 1.0,
    "joint": al.joints.Fixed(),
    "links": [al.shapes.Sphere(np.zeros(3))] * 3,
    "kane": _kane(),
    "lagrange": _lagrange(),
    "levels": [0.0, 1.0, 0.0],
    "lower": 0.0,
    "mass": 1.0,
    "minimize": al.terminal("x").mean,
    "model": _TWO,
    "motion": {},
    "name": "x",
    "names": "stress",
    "normal": np.ones(3),
    "numbers": {_K: 1.0},
    "offset": 0.0,
    "output": "x",
    "outputs": {"y": 2 * _K},
    "pairs": {"x": "y"},
    "parent": "arm",
    "parts": {"arm": al.Body("arm", joint=al.joints.Fixed(), mass=1.0)},
    "path": "nobody.xml",
    "position": 1.0,
    "power": 2.0,
    "problem": bar_problem,
    "q": np.zeros(1),
    "rate": 1.0,
    "rates": {_X: -_K * _X},
    "references": {"x": 1.0},
    "s": 1.0,
    "scale": 1.0,
    "second": al.output("mass"),
    "signals": al.Tabulated([0.0, 1.0], [0.0, 1.0]),
    "solution": solution,
    "solutions": solution,
    "stack": al.Assembly({"a": al.toleranced("1 ±0.1")}, features={"x": "2*a"}),
    "start": (0.0, 0.0),
    "std": 1.0,
    "steps": 4,
    "subject": bar_problem,
    "system": Decay(1.0),
    "t_final": 1.0,
    "text": "2 ± 0.1",
    "times": [0.0, 1.0],
    "torques": "x",
    "upper": 1.0,
    "values": [0.0, 1.0],
    "velocity": 1.0,
    "weight": 1.0,
    "weights": [1.0, 2.0],
    "width": 1.0,
    "x": 1.0,
    "wishes": {"light": al.output("mass").mean, "strong": al.output("stress").mean},
}
# Right values where a name means something else, or where the others are refused without it.
PARTICULAR: dict[str, dict[str, Any]] = {
    "Beta": {"alpha": 2.0, "beta": 3.0},
    "BSpline": {"free": np.zeros(4)},
    "Exponential": {"mean": 1.0},
    "Gamma": {"shape": 2.0, "scale": 1.0},
    "Gumbel": {"location": 2.0, "scale": 1.0},
    "Integer": {"lower": 0, "upper": 1},
    "LogNormal": {"mean": 1.0, "std": 0.1},
    "Normal": {"mean": 1.0, "std": 0.1},
    "Toleranced": {"nominal": 1.0, "tolerance": 0.1, "cp": 1.0},
    "Triangular": {"lower": 0.0, "mode": 1.0, "upper": 2.0},
    "TruncatedNormal": {"location": 0.0, "scale": 1.0},
    "Uniform": {"mean": 1.0, "half_width": 0.1},
    "Weibull": {"scale": 2.0, "shape": 1.5},
    "Density": {"function": lambda x: 1.0 + 0.0 * x, "lower": 0.0, "upper": 1.0},
    "ForwardDynamics": {"model": Pendulum()},
    "Grid": {"until": "floor", "at_most": 1.0, "steps": 4},
    "HybridDynamics": {"model": Crane(), "motion": {"trolley": al.PowerSeries(start=(0.0, 0.0), end=(1.0, 0.0))}},
    "InverseDynamics": {"model": Pendulum(), "motion": {"angle": al.PowerSeries(start=(0.0, 0.0), end=(1.0, 0.0))}},
    "Problem": {"grid": al.Grid(1.0, 2)},
    "actuation_of": {"model": Pendulum()},
    "residuals": {"data": [0.0, 1.0]},
    "cross_check": {"problem": oscillator_problem},
    "expand": {"function": lambda at: np.ones(3) * at["a"]},
    "fit_control_points": {"path": np.linspace(0.0, 1.0, 20), "free": 4},
    "tolerance_analysis": {"upper": 9.0, "output": lambda at: at["a"] * at["b"]},
    "validate_all": {"designs": solutions},
    "joints.Closure": {"child": "leg"},
    "joints.Coupling": {"follower": "hand", "leader": "arm"},
    "shapes.Capsule": {"start": np.zeros(3)},
    "trade_off": {"problem": bar_problem},
}
DEAR = (bar_problem, oscillator_problem, solution, solutions)


# Results of others, and what needs a file to begin with: see tests/foreign.
NOT_CALLED = (
    Exception,
    enum.Enum,
    tuple,
    al.references.Estimate,
    al.foreign.Fmu,
    al.foreign.FmuSimulation,
    al.foreign.FmuSystem,
)


def callables() -> Iterator[tuple[str, Callable[..., Any]]]:
    """What users call: functions, and classes that are no bases, errors, enumerations, tuples or results of calls."""
    public = {
        f"{place.__name__}.{name}".removeprefix("aleator."): getattr(place, name)
        for place in (al, *(getattr(al, topic) for topic in TOPICS if topic != "results"))
        for name in dir(place)
        if getattr(getattr(place, name), "__module__", "").startswith("aleator.")
    }
    made = {part for value in public.values() if inspect.isfunction(value) for part in _returned(value)}
    made |= {getattr(al.results, name) for name in dir(al.results) if not name.startswith("_")}
    for name, value in public.items():
        is_made = value in made and name not in PARTICULAR
        if not is_made and not (
            inspect.isclass(value) and (inspect.isabstract(value) or issubclass(value, NOT_CALLED))
        ):
            yield name, value


def _returned(function: Callable[..., Any]) -> tuple[Any, ...]:
    hint = typing.get_type_hints(function).get("return")
    return (hint, *typing.get_args(hint))


CALLABLES = dict(callables())


def amiss(name: str) -> Iterator[str]:
    """What `name` does not refuse, or not in words that name the argument."""
    function = CALLABLES[name]
    parameters = inspect.signature(function).parameters
    particular = PARTICULAR.get(name, {})
    required = {key: USUAL[key] for key, one in parameters.items() if one.default is one.empty and key in USUAL}
    values = (required | particular).items()
    usual = {key: value() if callable(value) and value in DEAR else value for key, value in values}
    for key, parameter in parameters.items():
        hint = str(parameter.annotation)
        if parameter.annotation is bool or parameter.kind is parameter.VAR_KEYWORD:
            continue
        for wrong, (value, words) in WRONG.items():
            # What a model calls gives NaN for NaN, which simulations look for.
            if any(word in hint for word in words) or (name.startswith("smooth.") and wrong == "not a number"):
                continue
            said = f"{name}({key}: {wrong})"
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    _call(function, usual | {key: value})
            except al.AleatorError as error:
                names = (key.removesuffix("s"), *key.split("_"), repr(value), type(value).__name__)
                if len(str(error)) > LONGEST or not any(word in str(error) for word in names):
                    yield f"{said} says: {error}"
            except Exception as error:
                yield f"{said} raises {type(error).__name__}: {error}"
            else:
                yield f"{said} is accepted"


def _call(function: Callable[..., Any], arguments: dict[str, Any]) -> Any:
    parameters = inspect.signature(function).parameters
    several = [key for key, one in parameters.items() if one.kind in (one.VAR_POSITIONAL, one.POSITIONAL_ONLY)]
    before = list(parameters)[: list(parameters).index(several[0]) + 1] if several else []
    positional = [arguments[key] for key in before if key in arguments]
    result = function(*positional, **{key: value for key, value in arguments.items() if key not in before})
    if isinstance(result, contextlib.AbstractContextManager):
        with result:
            pass


@pytest.fixture(autouse=True)
def without_checks_of_shapes(monkeypatch):
    """As users have it: the tests check shapes of arrays, the library itself does not."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


@pytest.mark.parametrize("name", CALLABLES)
def test_a_wrong_argument_is_refused_in_one_sentence_that_names_it(name):
    assert list(amiss(name)) == []


def test_every_public_callable_is_asked():
    assert {"Normal", "Problem", "solve", "validate", "expand", "report", "solvers.Ipopt", "points.SobolPoints"} <= set(
        CALLABLES
    )
    assert len(CALLABLES) > 110


# --- The validators at the border ------------------------------------------------------------------------------------


def test_a_checked_number_is_stored_as_a_plain_one():
    for value in (np.float64(0.5), np.float32(0.5), np.array(0.5)):
        assert type(border.real("it", value)) is float
    assert type(border.whole("it", np.int32(3))) is int
    table = np.array([1.0, 2.0])
    stored = border.real_array("it", table)
    table[0] = 9.0
    assert stored[0] == 1.0, "a later change of the user's array changed what was declared"


# --- Words that lead on ----------------------------------------------------------------------------------------------


def test_an_error_of_a_models_own_code_is_no_wrong_argument():
    with pytest.raises(TypeError, match="of its own"):
        type("Own", (Decay,), {"__init__": _of_its_own})(1.0)


def _of_its_own(self, rate):
    raise TypeError("of its own")


def test_a_long_value_is_shortened_and_a_misspelt_name_leads_to_the_right_one():
    assert len(str(border.refusal("it", "a number", "x" * 10_000))) < LONGEST
    assert border.meant("stifness", ["stiffness", "mass"]) == " Did you mean 'stiffness'?"
    assert border.meant("zzz", ["stiffness", "mass"]) == ""


# --- Code of a user's own --------------------------------------------------------------------------------------------


def system(**methods: Any) -> al.System:
    """A system `x' = -x` with some methods or fields other than they should be."""
    usual = {"states": ("x",), "rhs": lambda self, t, z: (-z.x,), "outputs": lambda self, t, z: {"x": z.x}}
    return type("Odd", (al.System,), usual | methods)()


def algebraic(**methods: Any) -> al.AlgebraicSystem:
    """An algebraic system `x = 1` with some methods other than they should be."""
    usual = {
        "unknowns": ("x",),
        "guess": lambda self: {"x": 1.0},
        "residual": lambda self, z: (z.x - 1.0,),
        "outputs": lambda self, z: {"x": z.x},
    }
    return type("Odd", (al.AlgebraicSystem,), usual | methods)()


# What a method does with a number, and what the refusal has to name.
BODIES: dict[str, tuple[Callable[[Any], Any], tuple[str, ...]]] = {
    "np.sin": (np.sin, ("jnp",)),
    "float": (float, ("jnp", "float")),
    "if": (lambda x: 1.0 if x > 0 else x, ("jnp.where",)),
    "range": (lambda x: sum(range(x)), ("Odd",)),
    "wrong name": (lambda x: x.nobody, ("nobody",)),
    "text": (lambda x: "fast", ("fast", "str")),
    "nothing": (lambda x: None, ("None",)),
    "masked": (lambda x: np.ma.masked, ("masked", "Masked")),
    "division by zero": (lambda x: x * (1 / 0), ("zero",)),
    "shape": (lambda x: x * np.ones(2), ("(2,)", "received 2")),
}


@pytest.mark.parametrize("name", BODIES)
def test_a_method_that_jax_cannot_trace_is_refused_with_what_to_write(name):
    body, words = BODIES[name]
    calls = {
        "rhs": lambda: al.simulate(system(rhs=lambda self, t, z: (body(z.x),)), al.Grid(1.0, 1)),
        "outputs": lambda: al.simulate(system(outputs=lambda self, t, z: {"x": body(z.x)}), al.Grid(1.0, 1)),
        "residual": lambda: al.simulate(algebraic(residual=lambda self, z: (body(z.x),))),
    }
    for method, call in calls.items():
        if (name, method) != ("shape", "outputs"):  # an output may have any
            refuses(call, *words)


METHODS: dict[str, tuple[dict[str, Any], str]] = {
    "states: nothing": ({"states": None}, "None"),
    "states: text": ({"states": "x"}, "'x'"),
    "states: keyword": ({"states": ("class",)}, "class"),
    "algebraic: a state": ({"algebraic": ("x",)}, "x"),
    "rhs: too many rates": ({"rhs": lambda self, t, z: (z.x, z.x)}, "2"),
    "rhs: no tuple": ({"rhs": lambda self, t, z: -z.x}, "rhs"),
    "rhs: no arguments": ({"rhs": lambda self: (1.0,)}, "1 positional"),
    "rhs: an input without a signal": ({"rhs": lambda self, t, z, force: (force,)}, "force"),
    "outputs: no dict": ({"outputs": lambda self, t, z: z.x}, "outputs"),
    "outputs: named by a number": ({"outputs": lambda self, t, z: {1: z.x}}, "1"),
    "initial: unknown": ({"initial": lambda self: {"nobody": 1.0}}, "nobody"),
    "initial: nan": ({"initial": lambda self: {"x": math.nan}}, "nan"),
}


@pytest.mark.parametrize("name", METHODS)
def test_a_system_that_is_written_wrongly_is_refused_by_the_place(name):
    methods, word = METHODS[name]
    refuses(lambda: al.simulate(system(**methods), al.Grid(1.0, 1)), word)


def test_a_missing_number_of_a_model_is_refused_where_it_stands():
    for value, words in [("fast", ["'str'"]), (None, ["None"]), (np.ma.masked, ["masked", "Masked"])]:
        refuses(lambda value=value: al.simulate(Decay(value), al.Grid(1.0, 1)), *words)
    refuses(lambda: al.simulate(algebraic(guess=lambda self: {"x": math.nan})), "nan")
    refuses(lambda: al.Normal(0.0, 1.0).shared(3), "3")
    refuses(lambda: al.expand(lambda at: at[""], {"": al.Normal(0.0, 1.0)}), "expected a name; received ''")
    refuses(lambda: al.Sample([1.0, 2.0, math.nan]), "received nan at entry 2")
    refuses(lambda: al.Normal(0.0, 5e-324), "at least 2.3e-308")


def test_an_objective_that_no_design_changes_is_refused_without_limits():
    model, number = bar_problem().system, typing.cast(Any, 3.0)
    refuses(lambda: al.Problem(model, minimize=number), "minimize: expected an expression")
    al.Problem(model, minimize=number, subject_to=[STRESS.mean <= 0.5])  # any design that holds


def test_instants_of_an_expanded_function_are_finite():
    inputs, instants = {"a": al.Uniform(0.0, half_width=1.0)}, [0.0, math.nan]
    refuses(lambda: al.expand(lambda at: at["a"] * np.ones(2), inputs, times=instants), "received nan at entry 1")


def refuses(call: Callable[[], Any], *words: str) -> None:
    with pytest.raises(al.AleatorError) as caught:
        call()
    message = str(caught.value)
    assert len(message) <= LONGEST, message
    assert any(word in message for word in words), f"expected one of {words} in: {message}"


# --- Files -----------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes of POSIX")
def test_what_need_not_end_is_read_nowhere(tmp_path, monkeypatch):
    pipe = tmp_path / "journal.jsonl"
    os.mkfifo(pipe)
    refuses(lambda: al.Tabulated.from_csv(pipe, "t", "x"), "a pipe or a device")
    refuses(lambda: al.Tabulated.from_csv("/dev/zero", "t", "x"), "a pipe or a device")
    refuses(lambda: al.foreign.read_urdf(pipe), "a pipe or a device")
    refuses(lambda: al.foreign.Fmu(pipe), "a pipe or a device", "install")
    refuses(lambda: al.journal(tmp_path).__enter__(), "a pipe or a device")
    (tmp_path / "table.csv").write_bytes(b"t,x\n0,1\n1,2\n")
    monkeypatch.setattr(arrays, "memory", lambda: 10)
    refuses(lambda: al.Tabulated.from_csv(tmp_path / "table.csv", "t", "x"), "larger than half of this machine's")
