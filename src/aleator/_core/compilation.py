"""Ahead-of-time compilation, once per structure of the arguments, with its time on record."""

import enum
import functools
import threading
import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer, eval_jaxpr
from jax.extend.core import ClosedJaxpr
from jaxtyping import Array

from aleator._core import programs
from aleator._core.arrays import Layout, Pytree, is_real
from aleator._core.equations import TracedFunction, asks_twice, must_run_alone
from aleator._core.errors import ProblemError
from aleator._core.identity import lasting_name, traced_once
from aleator._core.parallel import Device, beside, devices, elsewhere, home, placed, undisturbed
from aleator._core.programs import PROGRAMS, Executable, Program

# The compiler with the options below; those of other devices know other options.
_CPU = "cpu"

# On a CPU, XLA removes `jax.lax.optimization_barrier` before it fuses loops, and then recomputes an intermediate result
# wherever it is used, such as the sine of an angle for each derivative that depends on it. Without the pass of this
# name, barriers last. Its default order of operations is meant for operations that run on several cores at once; those
# of a step in time are too short for that, and run twice as fast one after the other.
_IN_ORDER: dict[str, str | bool] = {
    "xla_disable_hlo_passes": "cse_barrier_expander",
    "xla_cpu_scheduler_type": "CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
}

# XLA divides a program into 32 parts to compile them at once. Without much optimisation these cost more than they save:
# a fifth of the time of all cores.
_IN_FEW_PARTS: dict[str, str | bool] = {"xla_cpu_parallel_codegen_split_count": "2"}

# Equations that JAX cannot differentiate or vectorise, by words of its own errors, and what to write instead.
_REMEDIES = {
    "custom_vjp": "'jax.custom_vjp', whose derivatives are taken backward alone; the program's are taken forward too: "
    "write the rule by 'jax.custom_jvp'",
    "pure_callback primitive": "'jax.pure_callback' for one realisation at a time; many are computed at once: give "
    "it a 'vmap_method', such as 'sequential'",
    "Pure callbacks do not support JVP": "'jax.pure_callback', which has no derivatives: give them by 'jax.custom_jvp'",
}

# This name marks the run-time checks of Equinox, and of libraries built on it, among the errors of XLA.
_CHECKED = "_EquinoxRuntimeError"


class Use(enum.Enum):
    """The use of a program, with its options of XLA on a CPU, because compilation takes longer than most runs.

    - `LOOPS`: many runs of steps in time;
    - `ROWS`: many runs of large equations without loops. Compiled faster without the emitters for fused operations,
      which speed up loops only;
    - `ONCE`: a few runs in all, or a search's short ones. Compiled faster with little optimisation;
    - `BRIEF`: short runs. Compiled four times as fast without any optimisation, and slower by a factor of two or three
      when run. Where a loop of many realisations ends by a condition of each, compiled as `ONCE`: without optimisation
      and those emitters, some such loops never end. JAX evaluates the condition twice in a step (see `asks_twice`), and
      the two may then differ in their last bit.
    """

    LOOPS = _IN_ORDER | {"xla_cpu_prefer_vector_width": "512"}
    ROWS = _IN_ORDER | {"xla_cpu_use_fusion_emitters": False}
    ONCE = ROWS | _IN_FEW_PARTS | {"xla_backend_optimization_level": "1"}
    BRIEF = ROWS | _IN_FEW_PARTS | {"xla_backend_optimization_level": "0"}

    def of(self, closed: ClosedJaxpr) -> "Use":
        """The use as which some equations are compiled."""
        return Use.ONCE if self is Use.BRIEF and asks_twice(closed.jaxpr) else self


@final
class Compiled:
    """A function compiled ahead of time: once for each structure of its arguments, whatever their numbers are.

    Arrays in the arguments (also deep inside a problem) are traced; all the rest is structure. Several threads may call
    it: they wait for a program that one of them is compiling. `compilations` counts these so far; `seconds` is how
    long this process has traced, compiled and loaded programs of all functions. Within a part that runs on another
    device (`over_devices`), so does the program; it is traced once.

    - `use`: the use of its programs, or a function of the arguments that gives it.
    """

    seconds: ClassVar[float] = 0.0
    _lock: ClassVar[threading.Lock] = threading.Lock()

    def __init__(self, function: Callable[..., Any], *, use: Use | Callable[..., Use] = Use.LOOPS):
        self._function, self._use = function, use
        self.compilations = 0

    def __call__(self, *arguments: Any) -> Any:
        program, leaves = self._program(arguments)
        return program()(*leaves)

    def prepare(self, *arguments: Any) -> Program:
        """Begin to compile, on another core, the program for arguments of this structure; it is traced here and now.

        The caller of what is returned compiles it, unless the other core has begun.
        """
        program, _ = self._program(arguments)
        if not program.is_ready:
            beside(program)
        return program

    def bound(self, *fixed: Any, packed: bool = True) -> "Bound":
        """The function with all arguments but the last fixed, for many calls that differ in that one: a tree of arrays.

        - `packed`: whether real numbers are passed in one vector, those of the result as NumPy arrays, which are not to
          be written to.
        """
        return Bound(self, fixed, packed=packed)

    def _program(self, arguments: tuple[Any, ...]) -> tuple[Program, list[Any]]:
        """The program for some arguments, and their arrays, which are its inputs."""
        dynamic, static = eqx.partition(arguments, eqx.is_array)
        layout = Layout.of(dynamic, packed=False)
        inputs = layout.arrays(dynamic)
        key = self.key((layout, False), static, inputs)
        return self.program(key, arguments, lambda inputs: eqx.combine(layout.read(inputs), static), inputs), inputs

    def key(self, layouts: Hashable, static: Pytree, inputs: list[Any]) -> Hashable:
        """The key of a program, from the layouts of inputs and results, what is no array, and the inputs' types."""
        leaves, structure = jax.tree.flatten(static)
        kinds = tuple(type(leaf) for leaf in leaves)  # 1 and True are equal, but not the same structure
        types = tuple((leaf.shape, leaf.dtype) for leaf in inputs)
        return self, layouts, structure, tuple(leaves), kinds, types, placed(inputs) or home()

    def program(
        self,
        key: Hashable,
        arguments: tuple[Any, ...],
        read: Callable[[list[Any]], tuple[Any, ...]],
        inputs: list[Any],
        *,
        packed: bool = False,
    ) -> Program:
        """The program of a key, traced if there is none yet; `read` gives the arguments from its inputs."""

        def build() -> Callable[[], Executable]:
            use = self._use if isinstance(self._use, Use) else self._use(*arguments)
            name = lasting_name(self._function, _shapes_alone(arguments), len(inputs), packed, use)

            def function(*inputs: Any) -> Any:
                return self._function(*read(list(inputs)))

            trace = functools.partial(self._traced, function, inputs, use, name, packed=packed)
            if not programs.is_kept(name):
                compiled, program.results = trace()
                return functools.partial(self._timed, compiled)

            def loaded() -> Executable:
                earlier = programs.load(name, inputs)
                return trace()[0]() if earlier is None else _ready(earlier[0], *earlier[1])

            return functools.partial(self._timed, loaded)

        program = PROGRAMS[key]
        program.trace(build)
        return program

    def _timed(self, make: Callable[[], Executable]) -> Executable:
        """An executable that is made now, on record."""
        started = time.perf_counter()
        executable = make()
        with Compiled._lock:
            self.compilations += 1
            Compiled.seconds += time.perf_counter() - started
        return executable

    def _traced(
        self, function: Callable[..., Any], inputs: list[Any], use: Use, name: str | None, *, packed: bool
    ) -> tuple[Callable[[], Executable], Pytree | None]:
        """Trace a function: what compiles it, and the shapes of its results, None if these are packed."""
        started = time.perf_counter()
        layouts: list[Layout] = []

        def flat(*inputs: Any) -> list[Array]:
            result = function(*inputs)
            layouts[:] = [Layout.of(result, packed=packed)]
            return layouts[0].arrays(result)

        with _explained():
            traced = jax.jit(flat).trace(*inputs)
            use, lowered = use.of(traced.jaxpr), traced.lower()
        alone = must_run_alone(traced.jaxpr.jaxpr)
        # Asked here, because what JAX is told of devices holds for one thread.
        bound_to = placed(inputs)
        platform, moves = (bound_to or home()).platform, bound_to is None and len(devices()) > 1
        with Compiled._lock:
            Compiled.seconds += time.perf_counter() - started

        def compiled() -> Executable:
            executable = compiled_for(use, lowered, platform)
            if name is not None:
                programs.keep(name, lowered, executable, (layouts[0], alone))
            ready = _ready(executable, layouts[0], alone)
            return _OnEach(ready, lambda: self._timed(here)) if moves else ready

        def here() -> Executable:
            PROGRAMS.make_room()
            again = traced.lower()
            return _ready(undisturbed(lambda: compiled_for(use, again, platform)), layouts[0], alone)

        return compiled, None if packed else layouts[0].read(traced.out_info)


def compiled_for(use: Use, lowered: jax.stages.Lowered, platform: str) -> jax.stages.Compiled:
    """Compile a traced program for devices of a platform, with default options if this XLA does not know ours."""
    try:
        return lowered.compile(compiler_options=use.value if platform == _CPU else {})
    except jax.errors.JaxRuntimeError as error:
        if "No such compile option" not in str(error):
            raise
        return lowered.compile()


@contextmanager
def _explained() -> Iterator[None]:
    """Raise `ProblemError` in the place of an error of JAX about equations that have no derivatives, or no batches."""
    try:
        yield
    except (TypeError, ValueError, NotImplementedError) as error:
        for words, remedy in _REMEDIES.items():
            if words in str(error):
                raise ProblemError(f"The equations use {remedy}.") from error
        raise


def _shapes_alone(tree: Pytree) -> Pytree:
    """A tree whose NumPy arrays, which are traced, are replaced by their shapes and types."""
    return jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) if isinstance(leaf, np.ndarray) else leaf, tree
    )


_ALONE = threading.Lock()


def _ready(executable: Executable, layout: Layout, alone: bool) -> Executable:
    """An executable that returns results in their own layout; see `must_run_alone`."""

    def ready(*inputs: Any) -> Any:
        with _ALONE if alone else nullcontext():
            results = _run(executable, *inputs)
        return layout.read([np.asarray(one) for one in results] if layout.is_packed else results)

    return ready


def _run(executable: Executable, *inputs: Any) -> list[Any]:
    """The results of an executable; NaN if run-time checks of a library inside stop it.

    The linear solvers of stiff integrators do so for derivatives that are not finite. Called with NaN throughout, the
    same executable returns NaN in the right shapes.
    """
    try:
        return jax.block_until_ready(executable(*inputs))
    except jax.errors.JaxRuntimeError as error:
        if _CHECKED not in str(error):
            raise
    nothing = jax.tree.map(lambda leaf: jnp.full_like(leaf, jnp.nan) if is_real(leaf) else leaf, inputs)
    return executable(*nothing)


@final
class _OnEach:
    """An executable of one device, and its copies for others, each compiled when it is first called there."""

    def __init__(self, at_home: Executable, compiled_here: Callable[[], Executable]):
        self._at_home, self._compiled_here = at_home, compiled_here
        self._copies: dict[Device, Executable] = {}
        self._lock = threading.Lock()

    def __call__(self, *inputs: Any) -> Any:
        device = elsewhere()
        if device is None:
            return self._at_home(*inputs)
        # One after the other: XLA compiles on all cores, and may find the second one in JAX's cache.
        with self._lock:
            if device not in self._copies:
                self._copies[device] = self._compiled_here()
        return self._copies[device](*inputs)


@final
class Bound:
    """A function of one tree of arrays, the rest of its arguments being fixed; see `Compiled.bound`."""

    def __init__(self, compiled: Compiled, fixed: tuple[Any, ...], *, packed: bool):
        self._compiled, self._fixed, self._packed = compiled, fixed, packed
        arrays, self._static = eqx.partition(fixed, eqx.is_array)
        self._layout = Layout.of(arrays, packed=packed)
        device = placed(arrays)
        self._moves, self._inputs = device is None, jax.device_put(self._layout.arrays(arrays), device)
        self._copies: dict[Device, list[Any]] = {}
        self._executables: dict[Any, Executable] = {}

    def is_known(self, last: Any) -> bool:
        """Whether there is a program for this structure already."""
        return self._key(last) in PROGRAMS

    def prepare(self, last: Any) -> Executable:
        """The executable for arguments of this structure, compiled now if it has not been."""
        structure = jax.tree.structure(last)
        if structure not in self._executables:
            self._executables[structure] = self._program(last)()
        return self._executables[structure]

    def begin(self, last: Any) -> Pytree | None:
        """Begin to compile on another core what calls with arguments of this structure run; traced here and now.

        - `last`: the argument, or its shapes alone.

        Returns the shapes of the results; None if these are packed, or the program is one of an earlier run.
        """
        program = self._program(last)
        if not program.is_ready:
            beside(program)
        return program.results

    def __call__(self, last: Any) -> Any:
        """The function's value."""
        return self.prepare(last)(*self._inputs_here(), *jax.tree.leaves(last))

    def _key(self, last: Any) -> Hashable:
        leaves, structure = jax.tree.flatten(last)
        return self._compiled.key((self._layout, structure, self._packed), self._static, [*self._inputs, *leaves])

    def _program(self, last: Any) -> Program:
        (leaves, structure), count = jax.tree.flatten(last), len(self._inputs)

        def read(inputs: list[Any]) -> tuple[Any, ...]:
            fixed = eqx.combine(self._layout.read(inputs[:count]), self._static)
            return *fixed, jax.tree.unflatten(structure, inputs[count:])

        arguments, inputs = (*self._fixed, last), [*self._inputs, *leaves]
        return self._compiled.program(self._key(last), arguments, read, inputs, packed=self._packed)

    def _inputs_here(self) -> list[Any]:
        """The fixed arguments on the device of the present part, to which they are copied once."""
        device = elsewhere()
        if device is None or not self._moves:
            return self._inputs
        if device not in self._copies:
            self._copies[device] = jax.device_put(self._inputs, device)
        return self._copies[device]


def _evaluated(function: TracedFunction, constants: list[Any], leaves: list[Any]) -> list[Any]:
    return eval_jaxpr(function.closed.jaxpr, constants, *leaves)


_EVALUATED = {use: Compiled(_evaluated, use=use) for use in Use}


def evaluate(function: Callable[..., Pytree], *arguments: Pytree, use: Use = Use.LOOPS) -> Pytree:
    """The value of a function of arrays in compiled form: compiled once for equal equations."""
    return evaluate_traced(traced_once(function, function, *arguments), *arguments, use=use)


def evaluate_traced(function: TracedFunction, *arguments: Pytree, use: Use = Use.LOOPS) -> Pytree:
    """The value of a traced function, whose constants may be other ones than those that it was compiled with."""
    constants, leaves = function.closed.consts, function.leaves(arguments)
    if any(isinstance(one, Tracer) for one in (*constants, *leaves)):
        results = function.within(constants, *leaves)
    else:
        results = _EVALUATED[use](function, constants, leaves)
    return eqx.combine(jax.tree.unflatten(function.results, results), function.rest)
