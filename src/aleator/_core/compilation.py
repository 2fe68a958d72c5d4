"""Ahead-of-time compilation, once per structure of the arguments, with its time on record."""

import enum
import functools
import threading
import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any, ClassVar, NamedTuple, final

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer, eval_jaxpr
from jax.extend.core import ClosedJaxpr
from jaxtyping import Array

from aleator._core import programs, uncollected
from aleator._core.arrays import Layout, Pytree
from aleator._core.equations import TracedFunction, asks_twice
from aleator._core.errors import ProblemError
from aleator._core.identity import lasting_name
from aleator._core.parallel import Device, beside, here, placed, undisturbed
from aleator._core.programs import PROGRAMS

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

    LOOPS = _IN_ORDER
    ROWS = _IN_ORDER | {"xla_cpu_use_fusion_emitters": False}
    ONCE = ROWS | _IN_FEW_PARTS | {"xla_backend_optimization_level": "1"}
    BRIEF = ROWS | _IN_FEW_PARTS | {"xla_backend_optimization_level": "0"}

    def of(self, closed: ClosedJaxpr) -> "Use":
        """The use as which some equations are compiled."""
        return Use.ONCE if self is Use.BRIEF and asks_twice(closed.jaxpr) else self


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


_ALONE = threading.Lock()


@final
class Program:
    """A function of arrays: traced by the thread that asks for it, and compiled by the first one that needs it.

    Other threads wait meanwhile. Nothing waits for a core: if another thread was to compile a program and has not
    begun, its caller compiles it. What fails is tried again by the next one who asks. Where a part of some work runs
    on another device (`over_devices`), the program is compiled for that one too.

    - `results`: their shapes; None if they are packed, or the program is one of an earlier run.
    """

    def __init__(self, compiled: "Compiled", device: Device | None):
        self.results: Any = None
        self._compiled, self._device = compiled, device
        self._lock = threading.RLock()
        self._traced: jax.stages.Traced | None = None
        self._executables: dict[Device, Callable[..., list[Array]]] = {}

    @property
    def is_ready(self) -> bool:
        """Whether it has been compiled."""
        return bool(self._executables)

    def trace(self, fixed: "Passed", rest: "Passed", *, packed: bool) -> None:
        """Trace it for some arguments unless this has been done; `packed`: whether real numbers of its results are."""
        with self._lock:
            if self._traced is not None or self._executables:
                return
            self._use = self._compiled.use(*fixed.arguments, *rest.arguments)
            how = fixed.layout.is_packed, packed, self._use
            shapes = fixed.layout.shapes(), rest.layout.shapes()
            self._name = lasting_name(self._compiled.function, shapes, *how)
            inputs, count = [*fixed.arrays, *rest.arrays], len(fixed.arrays)
            with uncollected(), _explained(), Compiled.timed():
                if (earlier := programs.load(self._name, inputs)) is not None:
                    executable, self._layout, self._is_alone = earlier
                    self._executables[self.device] = executable
                    self._compiled.compilations += 1
                    return

                def flat(*inputs: Any) -> list[Any]:
                    arguments = *fixed.layout.read(inputs[:count]), *rest.layout.read(inputs[count:])
                    result = self._compiled.function(*arguments)
                    self._layout = Layout.of(result, packed=packed)
                    return self._layout.arrays(result)

                self._traced = jax.jit(flat).trace(*inputs)
            self.results = None if packed else self._layout.read(self._traced.out_info)

    @property
    def device(self) -> Device:
        """Where it runs if it is called now."""
        return self._device or here()

    def on(self, device: Device) -> Callable[..., list[Array]]:
        """The executable for a device, compiled now if it has not been."""
        # After Ctrl-C, XLA would go on compiling, and a process that ends meanwhile is aborted.
        return self._executables.get(device) or undisturbed(lambda: self._made(device))

    def _made(self, device: Device) -> Callable[..., list[Array]]:
        with self._lock:
            if device not in self._executables:
                assert self._traced is not None
                PROGRAMS.make_room()
                with Compiled.timed(), _explained(), jax.default_device(device):
                    with uncollected():
                        lowered = self._traced.lower()
                    executable = compiled_for(self._use.of(self._traced.jaxpr), lowered, device.platform)
                outside = programs.functions_outside(lowered)
                # JAX 0.10 shares out the factorisations of many matrices among XLA's threads, each of which waits for
                # the others: two at once may do so forever. What calls Python may run another program inside.
                self._is_alone = bool(outside) and programs.is_lapack(outside)
                self._executables[device] = executable
                self._compiled.compilations += 1
                programs.keep(self._name, executable, self._layout, outside)
                if len(self._executables) == len(jax.local_devices(backend=device.platform)):
                    self._traced = None  # with what it holds
            return self._executables[device]

    def __call__(self, *inputs: Any) -> Pytree:
        """The function's value; NaN if run-time checks of a library inside stop it.

        The linear solvers of stiff integrators do so for derivatives that are not finite. Called with NaN throughout,
        the same executable returns NaN in the right shapes.
        """
        executable = self.on(self.device)
        with _ALONE if self._is_alone else nullcontext():
            try:
                results = jax.block_until_ready(executable(*inputs))
            except jax.errors.JaxRuntimeError as error:
                if _CHECKED not in str(error):
                    raise
                results = executable(*(one * np.nan if one.dtype == float else one for one in inputs))
        return self._layout.read([np.asarray(one) for one in results] if self._layout.is_packed else results)


@final
class Compiled:
    """A function compiled ahead of time: once for each structure of its arguments, whatever their numbers are.

    Arrays in the arguments (also deep inside a problem) are traced; all the rest is structure. Several threads may call
    it. `compilations` counts its programs so far; `seconds` is how long this process has traced, compiled and loaded
    programs of all functions.

    - `use`: the use of its programs, or a function of the arguments that gives it.
    """

    seconds: ClassVar[float] = 0.0
    _timing: ClassVar[int] = 0
    _since: ClassVar[float] = 0.0
    _lock: ClassVar[threading.Lock] = threading.Lock()

    def __init__(self, function: Callable[..., Any], *, use: Use | Callable[..., Use] = Use.LOOPS):
        self.function = function
        self.use: Callable[..., Use] = (lambda *_: use) if isinstance(use, Use) else use
        self.compilations = 0

    def __call__(self, *arguments: Any) -> Any:
        return self.bound(packed=False)(*arguments)

    def prepare(self, *arguments: Any) -> None:
        """See `Bound.begin`."""
        self.bound(packed=False).begin(*arguments)

    def bound(self, *fixed: Any, packed: bool = True) -> "Bound":
        """The function with its first arguments fixed, for many calls that differ in the others.

        - `packed`: whether real numbers among the fixed arguments are passed in one vector, and those of the result,
          whose arrays are then of NumPy and not to be written to.
        """
        return Bound(self, fixed, packed=packed)

    @classmethod
    @contextmanager
    def timed(cls) -> Iterator[None]:
        """Put the time of a block on record; that of several threads at once counts once."""
        with cls._lock:
            cls._since = cls._since if cls._timing else time.perf_counter()
            cls._timing += 1
        try:
            yield
        finally:
            with cls._lock:
                cls._timing -= 1
                now = time.perf_counter()
                cls.seconds, cls._since = cls.seconds + now - cls._since, now


class Passed(NamedTuple):
    """Some arguments of a function as they are passed to an executable."""

    arguments: tuple[Any, ...]
    layout: Layout
    arrays: list[Any]

    @classmethod
    def of(cls, arguments: tuple[Any, ...], *, packed: bool = False) -> "Passed":
        layout = Layout.of(arguments, packed=packed)
        return cls(arguments, layout, layout.arrays(arguments))


@final
class Bound:
    """A compiled function of the arguments that are not fixed; see `Compiled.bound`."""

    def __init__(self, compiled: Compiled, fixed: tuple[Any, ...], *, packed: bool):
        self._compiled, self._packed, self._device = compiled, packed, placed(fixed)
        passed = Passed.of(fixed, packed=packed)
        self._fixed = passed._replace(arrays=jax.device_put(passed.arrays, self._device))
        self._programs: dict[Layout, Program] = {}

    def is_known(self, *rest: Any) -> bool:
        """Whether there is a program for arguments of this structure already."""
        return self._key(Passed.of(rest)) in PROGRAMS

    def prepare(self, *rest: Any) -> None:
        """Compile now what calls with arguments of this structure run, if this has not been done."""
        program = self._program(Passed.of(rest))
        program.on(program.device)

    def begin(self, *rest: Any) -> Pytree | None:
        """Begin to compile on another core what calls with arguments of this structure run; traced here and now.

        - `rest`: the arguments, or the shapes of their arrays.

        Returns the shapes of the results; None if these are packed, or the program is one of an earlier run.
        """
        program = self._program(Passed.of(rest))
        if not program.is_ready:
            beside(program.on, program.device)
        return program.results

    def __call__(self, *rest: Any) -> Any:
        passed = Passed.of(rest)
        return self._program(passed)(*self._fixed.arrays, *passed.arrays)

    def _key(self, rest: Passed) -> Hashable:
        device = self._device or placed(rest.arrays)
        return self._compiled, self._fixed.layout, rest.layout, self._packed, device, here().platform

    def _program(self, rest: Passed) -> Program:
        program = self._programs.get(rest.layout)
        if program is None:
            made = functools.partial(Program, self._compiled, self._device or placed(rest.arrays))
            program = PROGRAMS.get(self._key(rest), made)
            program.trace(self._fixed, rest, packed=self._packed)
            self._programs[rest.layout] = program
        return program


def _evaluated(function: TracedFunction, constants: list[Any], leaves: list[Any]) -> list[Any]:
    return eval_jaxpr(function.closed.jaxpr, constants, *leaves)


_EVALUATED = {use: Compiled(_evaluated, use=use) for use in Use}


def evaluate(function: Callable[..., Pytree], *arguments: Pytree, use: Use = Use.LOOPS) -> Pytree:
    """The value of a function of arrays in compiled form: traced now, and compiled once for equal equations."""
    return evaluate_traced(TracedFunction(function, *arguments), *arguments, use=use)


def evaluate_traced(function: TracedFunction, *arguments: Pytree, use: Use = Use.LOOPS) -> Pytree:
    """The value of a traced function, whose constants may be other ones than those that it was compiled with."""
    constants, leaves = function.closed.consts, function.leaves(arguments)
    if any(isinstance(one, Tracer) for one in (*constants, *leaves)):
        results = function.within(constants, *leaves)
    else:
        results = _EVALUATED[use](function, constants, leaves)
    return eqx.combine(jax.tree.unflatten(function.results, results), function.rest)
