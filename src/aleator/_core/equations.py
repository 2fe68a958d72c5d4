"""Functions as their traced equations, and digests that tell these apart in any process."""

import hashlib
import inspect
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from types import FunctionType
from typing import Any, NamedTuple, TypeAlias, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.ad_checkpoint import checkpoint_name
from jax.core import Tracer, eval_jaxpr
from jax.custom_derivatives import SymbolicZero
from jax.extend.core import ClosedJaxpr, Literal, Primitive
from jax.interpreters import batching, mlir
from jax.interpreters.partial_eval import dce_jaxpr
from jaxtyping import Array, Bool

from aleator._core import programs
from aleator._core.arrays import Layout, Pytree, numbers_to_arrays
from aleator._core.errors import ProblemError

# Parameters of equations that hold Python code: of `jax.pure_callback` and the like, and rules of `jax.custom_vjp`.
_OPAQUE = {"callback", "bwd", "fwd_jaxpr_thunk"}

# Rules that add nothing to the equations, as JAX describes functions. Each is identified by its place in the source: a
# user's rule that JAX or a decorator wraps would otherwise pass for a function of theirs.
_DERIVED: set[str] = set()


class Digest(NamedTuple):
    """What tells equations apart.

    - `text`: equal for equal equations, in any process; `is_whole`: whether they show all that is computed. They do not
      if they call Python code, by `jax.pure_callback` or as the rules of `jax.custom_vjp`.
    """

    text: str
    is_whole: bool

    def refuse_other(self, here: "Digest", who: str) -> None:
        """Raise `ProblemError` if equations that came from another process, called `who`, are others here."""
        if self != here:
            raise ProblemError(
                f"{who}: the code of this process gives other equations than those that the problem was declared with "
                "in another one. Start workers anew, with the same files; solve stored designs again."
            )


def digest_of(closed: ClosedJaxpr, *, constants: bool = True) -> Digest:
    """The digest of a traced function: of its equations, the inner arrays and rules of these, and its `constants`."""
    digest, is_whole = hashlib.sha256(str(closed.jaxpr).encode()), True
    for part in itertools.chain(closed.consts if constants else (), _hidden(closed.jaxpr)):
        if isinstance(part, Tracer) or callable(part):
            is_whole = False
            break
        digest.update(part.encode() if isinstance(part, str) else array_digest(part).encode())
    return Digest(digest.hexdigest(), is_whole)


def joint_digest(parts: Mapping[str, Digest]) -> Digest:
    """One digest of several, by name."""
    text = "\n".join(f"{name} {one.text}" for name, one in parts.items())
    return Digest(hashlib.sha256(text.encode()).hexdigest(), all(one.is_whole for one in parts.values()))


# Digests of equations that two traces have given: one trace of these is enough.
_STEADY: set[Digest] = set()


def refuse_unsteady(name: str, digest: Digest, again: Callable[[], Digest]) -> None:
    """Raise `ProblemError` if a second trace of a user's code called `name` has another digest than the first.

    The second may be that of an earlier run: code that computes something else each time does so in each run.
    """
    if digest in _STEADY or (digest.is_whole and programs.is_marked(digest.text)):
        return
    if again() != digest:
        raise ProblemError(
            f"{name} computes something else each time it is called, so that no result holds. Expected code that "
            "depends on its arguments and fields alone: put a distribution, such as al.Normal(0.0, 1.0), in the place "
            "of a random number; read files, clocks and counters beforehand."
        )
    _STEADY.add(digest)
    if digest.is_whole:
        programs.mark(digest.text)


def array_digest(array: Any) -> str:
    """Shape, type and values of an array as a short text."""
    values = np.asarray(array)
    return f"{values.shape}{values.dtype}{hashlib.sha256(values.tobytes()).hexdigest()}"


def derived(rule: FunctionType) -> FunctionType:
    """Mark a rule of a `jax.custom_jvp` function that holds nothing beyond the function's own equations."""
    code = inspect.unwrap(rule).__code__
    _DERIVED.add(f"{rule.__name__} at {code.co_filename}:{code.co_firstlineno}")
    return rule


def with_slope(function: Callable[..., Any], slope: Callable[..., Any], parameters: Pytree, *state: Any) -> Any:
    """`function(parameters, *state)`, whose derivatives by the state are given, and by the parameters JAX's.

    `slope(parameters, value, state, changes)` tells how the value changes with the state, parts of which may be None.
    It must follow from the function alone, whose equations are all that digests see of both.
    """
    numbers, rest = eqx.partition((parameters, state), _is_differentiable)
    if not jax.tree.leaves(numbers):
        return function(parameters, *state)

    @jax.custom_jvp
    def evaluated(numbers: Pytree) -> Pytree:
        parameters, state = eqx.combine(numbers, rest)
        return function(parameters, *state)

    def tangent(primals: tuple[Pytree], tangents: tuple[Pytree]) -> tuple[Pytree, Pytree]:
        (numbers,), ((of_parameters, of_state),) = primals, tangents
        parameters, state = eqx.combine(numbers, rest)
        value = evaluated(numbers)
        changes = [
            None if part is None else np.zeros(part.shape) if change is None or is_still(change) else change
            for part, change in zip(state, of_state, strict=True)
        ]
        change = slope(parameters, value, state, changes)
        if not all(map(is_still, jax.tree.leaves(of_parameters, is_leaf=is_still))):
            along = jax.tree.map(lambda at, by: jnp.zeros_like(at) if is_still(by) else by, numbers[0], of_parameters)
            direct = jax.jvp(lambda at: function(eqx.combine(at, rest[0]), *state), (numbers[0],), (along,))[1]
            change = jax.tree.map(jnp.add, change, direct)
        return value, change

    evaluated.defjvp(derived(tangent), symbolic_zeros=True)
    return evaluated(numbers)


def _is_differentiable(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jnp.inexact)


def is_still(change: Any) -> bool:
    return isinstance(change, SymbolicZero)


def equations_in(jaxpr: Any) -> Iterator[Any]:
    """All equations, those inside others included."""
    for equation in jaxpr.eqns:
        yield equation
        for part in jax.tree.leaves(equation.params):
            if hasattr(part, "eqns"):
                yield from equations_in(part)


_State = TypeVar("_State")

# Whether something is so in any realisation: itself, where there is one.
_anywhere = Primitive("anywhere")
_anywhere.def_impl(lambda is_true: is_true)
_anywhere.def_abstract_eval(lambda is_true: is_true)
mlir.register_lowering(_anywhere, lambda _, is_true: [is_true])
batching.primitive_batchers[_anywhere] = lambda each, axes: (jnp.any(each[0], axis=axes[0]), None)


def loop_while_any(
    goes_on: Callable[[_State], Bool[Array, ""]], advance: Callable[[_State], _State], begin: _State
) -> _State:
    """`jax.lax.while_loop`, vectorised without a choice between old and new for each part of the state: `advance` must
    leave a state that does not go on as it is.
    """

    def step(carried: tuple[Array, _State]) -> tuple[Array, _State]:
        state = advance(carried[1])
        return _anywhere.bind(goes_on(state)), state

    return jax.lax.while_loop(lambda carried: carried[0], step, (_anywhere.bind(goes_on(begin)), begin))[1]


def asks_twice(jaxpr: Any) -> bool:
    """Whether there is a loop of many realisations, each of which goes on by a condition of its own.

    JAX evaluates this twice in a step, to go on and to change the numbers; that of `loop_while_any` once, as that of a
    loop of one realisation.
    """
    loops = (one.params["cond_jaxpr"] for one in equations_in(jaxpr) if one.primitive.name == "while")
    return any(one.out_avals[0].shape for one in loops)


# Equations that may change with a number by which they have no derivative, or have one of their own.
_LOSING = ("stop_gradient", "round", "floor", "ceil", "sign", "custom_jvp_call", "pure_callback")


def may_lose_derivatives(jaxpr: Any) -> bool:
    """Whether derivatives may be others than those of the values: elsewhere JAX's are exact."""
    return any((one.primitive.name in _LOSING and not _is_derived(one)) or _is_cast(one) for one in equations_in(jaxpr))


# Equations whose values jump where those that they are made of do not.
_JUMPING = ("lt", "le", "gt", "ge", "eq", "ne", "sign", "floor", "ceil", "round")
# How loops and branches are called, whose inner variables are other ones than their own.
_FLOW = ("scan", "while", "cond")

Marks: TypeAlias = frozenset[str]
TIME = "time"
"""The mark of what depends on the time."""


def as_time(t: Any) -> Any:
    """The same time, marked in the equations of functions that are traced later."""
    return checkpoint_name(t, TIME)


def switches(jaxpr: Any, given: Sequence[Marks] | None = None) -> set[Marks]:
    """The marks of what decides jumps: of the operands of comparisons, signs and rounding, inner ones included.

    `given`: those of the arguments, in order. What depends on anything marked has its marks; so has `as_time`.
    """
    found = set[Marks]()
    _marked(jaxpr, [frozenset[str]()] * len(jaxpr.invars) if given is None else given, found)
    return found


def _marked(jaxpr: Any, given: Sequence[Marks], found: set[Marks]) -> list[Marks]:
    """The marks of the results; those that decide jumps join `found`."""
    known: dict[Any, Marks] = dict(zip(jaxpr.invars, given, strict=True))

    def read(variable: Any) -> Marks:
        return frozenset() if isinstance(variable, Literal) else known.get(variable, frozenset())

    for equation in jaxpr.eqns:
        name, own = equation.primitive.name, [read(one) for one in equation.invars]
        every = frozenset[str]().union(*own, [TIME] if name == "name" and equation.params["name"] == TIME else [])
        results = [every] * len(equation.outvars)
        for part in jax.tree.leaves(equation.params):
            inner = getattr(part, "jaxpr", part)
            if hasattr(inner, "eqns"):
                is_same = name not in _FLOW and len(inner.invars) == len(own)
                outcome = _marked(inner, own if is_same else [every] * len(inner.invars), found)
                results = outcome if is_same and len(outcome) == len(results) else results
        if every and (name in _JUMPING or name == "cond" or _is_cast(equation)):
            found.add(every)
        known.update(zip(equation.outvars, results, strict=True))
    return [read(one) for one in jaxpr.outvars]


def _is_cast(equation: Any) -> bool:
    """Whether numbers become whole ones."""
    return equation.primitive.name == "convert_element_type" and jnp.issubdtype(
        equation.params["new_dtype"], jnp.integer
    )


def _hidden(jaxpr: Any, *, rules: bool = True) -> Iterator[Any]:
    """The parts that printed equations do not show: arrays, and rules of differentiation as texts, in order.

    A rule may use its own function, so that rules inside rules are identified by their place in the source.
    """
    for equation in jaxpr.eqns:
        if rules and equation.primitive.name == "custom_jvp_call":
            yield from _forward_rule(equation)
        if not _OPAQUE.isdisjoint(equation.params):
            yield _opaque
        for part in jax.tree.leaves(equation.params):
            if isinstance(part, ClosedJaxpr):
                yield from part.consts
                yield from _hidden(part.jaxpr, rules=rules)
            elif hasattr(part, "eqns"):
                yield from _hidden(part, rules=rules)
            elif hasattr(part, "debug_info"):
                yield str(part.debug_info.func_src_info)
            elif isinstance(part, FunctionType | partial):
                yield part


def _is_derived(equation: Any) -> bool:
    """Whether an equation has a rule of ours, which holds nothing beyond the function's own equations."""
    information = getattr(equation.params.get("jvp_jaxpr_fun"), "debug_info", None)
    return information is not None and information.func_src_info in _DERIVED


def _opaque() -> None:
    """A placeholder for callable objects that are no Python functions."""


def _forward_rule(equation: Any) -> Iterator[Any]:
    """The traced rule of a `jax.custom_jvp` function, because it may hold numbers that the source does not show.

    A `derived` one does not, and tracing it may take longer than all the rest.
    """
    traced = equation.params["jvp_jaxpr_fun"]
    if _is_derived(equation):
        yield traced.debug_info.func_src_info
        return
    variables = len(equation.invars) - equation.params["num_consts"]
    rule, held, *_ = traced.call_wrapped(*[False] * variables)
    yield str(rule)
    yield from held
    yield from _hidden(rule, rules=False)


@final
class TracedFunction:
    """A function of trees of arrays as its equations; equal to another one if these are, whatever their constants.

    - `closed`: the equations; `layout`: of the arguments, with all that is no array, such as whole numbers;
    - `results`: the structure of the result's numbers; `rest`: its parts that are no numbers.
    """

    def __init__(self, function: Callable[..., Pytree], *arguments: Pytree):
        """Trace a function for arguments like these; nothing is computed."""
        arguments = numbers_to_arrays(arguments)
        self.layout = Layout.of(arguments, packed=False)
        self.rest: Pytree = None

        def arrays(*numbers: Any) -> Pytree:
            results, self.rest = eqx.partition(function(*self.layout.read(numbers)), eqx.is_array)
            return results

        self.closed, shapes = jax.make_jaxpr(arrays, return_shape=True)(*self.layout.arrays(arguments))
        self.results = jax.tree.structure(shapes)

    @cached_property
    def digest(self) -> Digest:
        """That of the equations without their constants."""
        return digest_of(self.closed, constants=False)

    @cached_property
    def within(self) -> Callable[..., list[jax.Array]]:
        """Its equations where JAX transforms them: one program, in the place of one for each operation."""
        return jax.jit(partial(eval_jaxpr, self.closed.jaxpr))

    @property
    def size(self) -> int:
        """The number of its equations, those inside others included."""
        return sum(1 for _ in equations_in(self.closed.jaxpr))

    def __call__(self, *arguments: Pytree) -> Pytree:
        """Its value, as a part of an outer function that is traced.

        Raises `ProblemError` for arguments of another structure than that of the equations.
        """
        return eqx.combine(self.part(lambda results: results, *arguments), self.rest)

    def part(self, chosen: Callable[[Pytree], Pytree], *arguments: Pytree) -> Pytree:
        """A part of its value, `chosen` among the numbers of the result, by the equations that this follows from."""
        leaves = self.leaves(arguments)
        part, needed = self._places(chosen)
        pruned, _ = dce_jaxpr(self.closed.jaxpr, needed, instantiate=True)
        values = dict(zip(np.flatnonzero(needed), eval_jaxpr(pruned, self.closed.consts, *leaves), strict=True))
        return jax.tree.map(values.__getitem__, part)

    def sources(self, chosen: Callable[[Pytree], Pytree]) -> list[bool]:
        """Whether a part of its value, `chosen` as above, follows from each number of the arguments, in order."""
        return dce_jaxpr(self.closed.jaxpr, self._places(chosen)[1])[1]

    def _places(self, chosen: Callable[[Pytree], Pytree]) -> tuple[Pytree, list[bool]]:
        """The places of a part among the numbers of the result, and whether it has each of these."""
        count = len(self.closed.jaxpr.outvars)
        part = chosen(jax.tree.unflatten(self.results, range(count)))
        needed = set(jax.tree.leaves(part))
        return part, [i in needed for i in range(count)]

    def leaves(self, arguments: tuple[Pytree, ...]) -> list[Any]:
        """The numbers of arguments, in order. Raises `ProblemError` if they do not go with the equations."""
        arguments = numbers_to_arrays(arguments)
        if Layout.of(arguments, packed=False) != self.layout:
            raise ProblemError(
                "The model has another structure than the one whose equations were traced: a whole number, a shape or "
                "a class is not what it was. Declare an al.Problem of the changed model."
            )
        return self.layout.arrays(arguments)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, TracedFunction) or not self.digest.is_whole:
            return self is other
        return self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)
