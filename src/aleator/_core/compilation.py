"""Ahead-of-time compilation, once per structure of the arguments, with its time on record."""

import enum
import functools
import threading
import time
from collections.abc import Callable, Hashable
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from aleator._core import stored
from aleator._core.beside import beside, undisturbed
from aleator._core.devices import Device, devices, elsewhere, home, placed
from aleator._core.differentiable import explained
from aleator._core.executables import OnEach, Tried, ready
from aleator._core.identity import lasting_name
from aleator._core.layouts import Leaves, Packed, Way, is_real
from aleator._core.programs import PROGRAMS, Executable, Program

# The compiler with the options below; those of other devices know other options.
_CPU = "cpu"

# On a CPU, XLA removes `jax.lax.optimization_barrier` before it fuses loops, and then recomputes an intermediate result
# wherever it is used, such as the sine of an angle for each derivative that depends on it. Without the pass of this
# name, barriers last.
_BARRIERS: dict[str, str | bool] = {"xla_disable_hlo_passes": "cse_barrier_expander"}


class Use(enum.Enum):
    """The use of a program, with its options of XLA on a CPU, because compilation takes longer than most runs.

    - `LOOPS`: many runs of steps in time;
    - `ROWS`: many runs of large equations without loops. Compiled faster without the emitters for fused operations,
      which speed up loops only;
    - `ONCE`: a few runs in all. Compiled faster with little optimisation. With none at all, and without those emitters,
      some loops of many realisations that end by a condition never end: JAX evaluates the condition twice in a step, to
      go on and to change the numbers, and without optimisation the two more often differ in their last bit.
    """

    LOOPS = _BARRIERS
    ROWS = _BARRIERS | {"xla_cpu_use_fusion_emitters": False}
    ONCE = ROWS | {"xla_backend_optimization_level": "1"}


@final
class Compiled:
    """A function compiled ahead of time: once for each structure of its arguments, whatever their numbers are.

    Arrays in the arguments (also deep inside a problem) are traced; all the rest is structure. `compilations` and
    `seconds` count all compilations so far. Several threads may call it: they wait for a program that one of them is
    compiling. Within a part that runs on another device (`over_devices`), so does the program; it is traced once.

    - `use`: the use of its programs, or a function of the arguments that gives it.
    """

    def __init__(self, function: Callable[..., Any], *, use: Use | Callable[..., Use] = Use.LOOPS):
        self._function, self._use = function, use
        self._lock = threading.Lock()
        self.compilations = 0
        self.seconds = 0.0

    def __call__(self, *arguments: Any) -> Any:
        program, leaves = self._found(arguments)
        return program()(*leaves)

    def prepare(self, *arguments: Any) -> None:
        """Begin to compile, on another core, the program for arguments of this structure.

        The function is traced immediately in this thread: a user's code need not be thread-safe. The numbers of the
        arguments do not matter.
        """
        program, _ = self._found(arguments)
        if not program.is_ready:
            beside(program)

    def begin(self, *arguments: Any) -> Callable[[], Any]:
        """Begin a call on another core; the function returned waits for the result. Traced immediately."""
        program, leaves = self._found(arguments)
        return beside(lambda: program()(*leaves))

    def _found(self, arguments: tuple[Any, ...]) -> tuple[Program, list[Any]]:
        """The program for some arguments, and their arrays, which are its inputs."""
        dynamic, static = eqx.partition(arguments, eqx.is_array)
        leaves, structure = jax.tree.flatten(dynamic)

        def flat(*leaves: jax.Array) -> Any:
            return self._function(*eqx.combine(jax.tree.unflatten(structure, leaves), static))

        build = functools.partial(self._compile, Leaves, flat, *leaves)
        return self._known(self._key("leaves", leaves, structure, static), arguments, build), leaves

    def bound(self, *fixed: Any, packed: bool = True) -> "Bound":
        """The function with all arguments but the last fixed, for many calls that differ in that one: a tree of arrays.

        Every array passed to or from an executable costs time at each call. So all real numbers of the fixed arguments
        are packed into one vector, and so are those of the result: NumPy arrays, not to be written to.

        - `packed`: whether to pack the result. Copying a large one takes longer than returning it as arrays of JAX.
        """
        reals, rest = eqx.partition(fixed, is_real)
        numbers, shapes = jax.tree.flatten(reals)
        ends = np.cumsum([leaf.size for leaf in numbers])[:-1].tolist()
        vector = jax.device_put(Packed.arrays(reals)[0], placed(numbers))
        arrays, static = eqx.partition(rest, eqx.is_array)
        # Leaves instead of trees, which would be flattened at every call.
        others, structure = jax.tree.flatten(arrays)

        def result(vector: jax.Array, others: list[jax.Array], last: Any) -> Any:
            parts = [part.reshape(leaf.shape) for part, leaf in zip(jnp.split(vector, ends), numbers, strict=False)]
            trees = jax.tree.unflatten(shapes, parts), jax.tree.unflatten(structure, others)
            return self._function(*eqx.combine(*trees, static), last)

        way, read_by = ("packed", Packed) if packed else ("bound", Leaves)

        def key(last: Any) -> Hashable:
            leaves, last_structure = jax.tree.flatten(last)
            trees = shapes, structure, last_structure
            return self._key(way, [*numbers, *others, *leaves], trees, static)

        def program(key: Hashable, last: Any) -> Program:
            build = functools.partial(self._compile, read_by, result, vector, others, last)
            return self._known(key, (*fixed, last), build)

        return Bound(key, program, (vector, others))

    def _key(self, way: str, leaves: list[Any], structure: Any, static: Any) -> Hashable:
        """The key of arguments of one structure."""
        static_leaves, static_structure = jax.tree.flatten(static)
        shapes = tuple((leaf.shape, leaf.dtype) for leaf in leaves)
        kinds = tuple(type(leaf) for leaf in static_leaves)  # 1 and True are equal, but not the same structure
        device = placed(leaves) or home()
        return self, way, structure, static_structure, tuple(static_leaves), kinds, shapes, device

    def _known(self, key: Any, arguments: tuple[Any, ...], build: Callable[..., Callable[[], Executable]]) -> Program:
        """The program of a key, traced by `build` if there is none yet."""
        program, is_new = PROGRAMS.found(key)
        if is_new:
            use = self._use if isinstance(self._use, Use) else self._use(*arguments)
            name = lasting_name(self._function, _alike(arguments), key[1], use)
            program.trace(functools.partial(build, use=use, name=name))
        elif program.was_interrupted():  # in the thread that was tracing
            return self._known(key, arguments, build)
        return program

    def _compile(
        self, way: Way, function: Callable[..., Any], *arguments: Any, use: Use, name: str | None
    ) -> Callable[[], Executable]:
        """Trace a function, unless an earlier run has kept its executable; the function returned compiles it."""
        started = time.perf_counter()
        trace = functools.partial(self._traced, way, function, *arguments, use=use, name=name)
        # In this thread, as tracing is: if it cannot be loaded, the function is traced here.
        earlier = stored.found(name, arguments)

        def anew() -> Executable:
            if name is not None:
                stored.forget(name)
            return trace()()

        made = trace() if earlier is None else functools.partial(Tried, ready(earlier), anew)
        spent = time.perf_counter() - started

        return lambda: self._counted(made, spent)

    def _counted(self, made: Callable[[], Executable], spent: float = 0.0) -> Executable:
        """An executable that is made now, on record with the time `spent` before."""
        started = time.perf_counter()
        executable = made()
        with self._lock:
            self.seconds += spent + time.perf_counter() - started
            self.compilations += 1
        return executable

    def _traced(
        self, way: Way, function: Callable[..., Any], *arguments: Any, use: Use, name: str | None
    ) -> Callable[[], Executable]:
        """Trace a function; the function returned compiles it and keeps it for later runs."""
        results: list[Any] = []

        def flat(*arguments: Any) -> list[Array]:
            result = function(*arguments)
            results[:] = [way.of(result)]
            return way.arrays(result)

        if stored.is_kept(name):
            # JAX finds programs by their text, this one among others: else it would find one of another name, which
            # could not be kept under this one.
            flat.__name__ = f"flat_{name}"
        with explained():
            traced = jax.jit(flat).trace(*arguments)
            lowered = traced.lower()
        # Asked here, because what JAX is told of devices holds for one thread.
        bound_to = placed(arguments)
        platform, moves = (bound_to or home()).platform, bound_to is None and len(devices()) > 1

        def finish() -> Executable:
            before = stored.found_by_jax()
            found = stored.Stored(compiled_for(use, lowered, platform), results[0])
            if name is not None and stored.found_by_jax() == before:
                stored.keep(name, lowered, found)
            return OnEach(ready(found), lambda: self._counted(here)) if moves else ready(found)

        def here() -> Executable:
            PROGRAMS.make_room()
            again = traced.lower()
            return ready(stored.Stored(undisturbed(lambda: compiled_for(use, again, platform)), results[0]))

        return finish


def compiled_for(use: Use, lowered: jax.stages.Lowered, platform: str) -> jax.stages.Compiled:
    """Compile a traced program for devices of a platform, with default options if this XLA does not know ours."""
    try:
        return lowered.compile(compiler_options=use.value if platform == _CPU else {})
    except jax.errors.JaxRuntimeError as error:
        if "No such compile option" not in str(error):
            raise
        return lowered.compile()


@final
class Bound:
    """A function of one tree of arrays, the rest of its arguments being fixed; see `Compiled.bound`."""

    def __init__(
        self,
        key: Callable[[Any], Hashable],
        program: Callable[[Hashable, Any], Program],
        given: tuple[jax.Array, list[jax.Array]],
    ):
        self._find_key, self._program, self._given = key, program, given
        self._moves = placed(given) is None
        self._copies: dict[Device, tuple[jax.Array, list[jax.Array]]] = {}
        self._key: Hashable | None = None
        self._executable: Executable | None = None

    def is_known(self, last: Any) -> bool:
        """Whether there is a program for this structure already."""
        self._key = self._find_key(last)
        return self._key in PROGRAMS

    def prepare(self, last: Any) -> Executable:
        """The executable for arguments of this structure, compiled now if it has not been."""
        if self._executable is None:
            self._executable = self._program(self._key or self._find_key(last), last)()
        return self._executable

    def begin(self, last: Any) -> None:
        """Begin to compile on another core what calls with arguments of this structure run; traced here and now."""
        program = self._program(self._find_key(last), last)
        if not program.is_ready:
            beside(program)

    def __call__(self, last: Any) -> Any:
        """The function's value."""
        return self.prepare(last)(*self._given_here(), last)

    def _given_here(self) -> tuple[jax.Array, list[jax.Array]]:
        """The fixed arguments on the device of the present part, to which they are copied once."""
        device = elsewhere()
        if device is None or not self._moves:
            return self._given
        if device not in self._copies:
            self._copies[device] = jax.device_put(self._given, device)
        return self._copies[device]


def _alike(tree: Any) -> Any:
    """A tree whose NumPy arrays, which are traced, are replaced by their shapes and types."""
    return jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) if isinstance(leaf, np.ndarray) else leaf, tree
    )
