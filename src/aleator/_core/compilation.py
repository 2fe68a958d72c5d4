"""Ahead-of-time compilation, once per structure of the arguments, with its time on record."""

import enum
import functools
import math
import threading
import time
from collections.abc import Callable, Hashable
from itertools import accumulate, pairwise
from typing import Any, NamedTuple, TypeAlias, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array

from aleator._core import stored
from aleator._core.beside import beside
from aleator._core.errors import ProblemError
from aleator._core.lasting import lasting_name
from aleator._core.programs import PROGRAMS, Executable, Program

# On a CPU, XLA takes `jax.lax.optimization_barrier` away before it fuses loops, and then computes an intermediate
# result again wherever it is used: the sine of an angle for each derivative that it takes part in. With its pass of
# this name left out, barriers last.
_BARRIERS: dict[str, str | bool] = {"xla_disable_hlo_passes": "cse_barrier_expander"}


class Use(enum.Enum):
    """What a program is compiled for, and by which options of XLA on a CPU: compiling takes longer than most runs.

    - `LOOPS`: steps in time, again and again;
    - `ROWS`: large equations without loops, again and again. Without the emitters for fused operations, which make
      loops faster and nothing else, it is ready sooner;
    - `ONCE`: a few runs in all. Hardly optimised, it is ready much sooner.
    """

    LOOPS = _BARRIERS
    ROWS = _BARRIERS | {"xla_cpu_use_fusion_emitters": False}
    ONCE = ROWS | {"xla_backend_optimization_level": "0"}


# By this name the checks of Equinox, and of what is built on it, are known among the errors of XLA.
_CHECKED = "_EquinoxRuntimeError"


@final
class Compiled:
    """A function compiled ahead of time: once for each structure of its arguments, whatever their numbers are.

    Arrays in the arguments (also deep inside a problem) are traced; all the rest is structure. `compilations` and
    `seconds` count what has been compiled so far. Several threads may call it: what one of them is compiling, the
    others wait for.

    - `use`: what programs are compiled for, or what tells it from the arguments.

    Where the arguments hold code, such as the methods of a system, what that reads beside them must be told apart too:

    - `code(*arguments)`: equal for code that computes the same, if the arguments do not say it themselves;
    - `unchanged(*arguments)`: raises if that may have changed while it was compiled, and nothing is kept.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        *,
        use: Use | Callable[..., Use] = Use.LOOPS,
        code: Callable[..., Hashable] | None = None,
        unchanged: Callable[..., None] | None = None,
    ):
        self._function, self._use, self._code, self._unchanged = function, use, code, unchanged
        self._lock = threading.Lock()
        self.compilations = 0
        self.seconds = 0.0

    def __call__(self, *arguments: Any) -> Any:
        program, leaves = self._found(arguments)
        return program()(*leaves)

    def prepare(self, *arguments: Any) -> None:
        """Begin to compile, on another core, what a call with arguments of this structure needs.

        The function is traced here and now: a user's code is never run by two threads of ours at once, which it need
        not bear. The numbers of the arguments do not matter.
        """
        program, _ = self._found(arguments)
        if not program.is_ready:
            beside(program)

    def begin(self, *arguments: Any) -> Callable[[], Any]:
        """Begin a call on another core; what is returned waits for its result. Traced here and now, as by `prepare`."""
        program, leaves = self._found(arguments)
        return beside(lambda: program()(*leaves))

    def _found(self, arguments: tuple[Any, ...]) -> tuple[Program, list[Any]]:
        """The program for some arguments, and their arrays, which it is given."""
        dynamic, static = eqx.partition(arguments, eqx.is_array)
        leaves, structure = jax.tree.flatten(dynamic)

        def flat(*leaves: jax.Array) -> Any:
            return self._function(*eqx.combine(jax.tree.unflatten(structure, leaves), static))

        build = functools.partial(self._compile, _Leaves, flat, *leaves)
        return self._known(self._key(arguments, "leaves", leaves, structure, static), arguments, build), leaves

    def bound(self, *fixed: Any, packed: bool = True) -> "Bound":
        """The function with all arguments but the last fixed, for many calls that differ in that one: a tree of arrays.

        At every call, each array that an executable is given or gives takes its time. So all real numbers of the fixed
        arguments travel as one vector, and so do those of the result: NumPy arrays, not to be written to.

        - `packed`: whether the result travels so. A large one takes longer to be copied than to be given as it is: as
          arrays of JAX.
        """
        reals, rest = eqx.partition(fixed, _is_real)
        vector, unpacked = ravel_pytree(reals)
        arrays, static = eqx.partition(rest, eqx.is_array)
        # Leaves in the place of trees, which would be taken apart at every call.
        others, structure = jax.tree.flatten(arrays)

        def result(vector: jax.Array, others: list[jax.Array], last: Any) -> Any:
            return self._function(*eqx.combine(unpacked(vector), jax.tree.unflatten(structure, others), static), last)

        way, read_by = ("packed", _Packed) if packed else ("bound", _Leaves)

        def key(last: Any) -> Hashable:
            leaves, last_structure = jax.tree.flatten(last)
            trees = jax.tree.structure(reals), structure, last_structure
            return self._key((*fixed, last), way, [*jax.tree.leaves(reals), *others, *leaves], trees, static)

        def program(key: Hashable, last: Any) -> Program:
            build = functools.partial(self._compile, read_by, result, vector, others, last)
            return self._known(key, (*fixed, last), build)

        return Bound(key, program, (vector, others))

    def _key(self, arguments: tuple[Any, ...], way: str, leaves: list[Any], structure: Any, static: Any) -> Hashable:
        """What arguments of one structure have in common."""
        static_leaves, static_structure = jax.tree.flatten(static)
        shapes = tuple((leaf.shape, leaf.dtype) for leaf in leaves)
        kinds = tuple(type(leaf) for leaf in static_leaves)  # 1 and True are equal, but not the same structure
        code = self._code(*arguments) if self._code else None
        return self, way, structure, static_structure, tuple(static_leaves), kinds, shapes, code

    def _known(
        self, key: Hashable, arguments: tuple[Any, ...], build: Callable[..., Callable[[], Executable]]
    ) -> Program:
        """The program of a key, traced by `build` where there has been none before."""
        program, is_new = PROGRAMS.found(key)
        if is_new:
            program.trace(functools.partial(self._checked, key, arguments, build))
        elif program.was_interrupted():  # in the thread that was tracing
            return self._known(key, arguments, build)
        return program

    def _checked(
        self, key: Any, arguments: tuple[Any, ...], build: Callable[..., Callable[[], Executable]]
    ) -> Callable[[], Executable]:
        """What compiles, once it is sure that what was traced is the code that it is kept for."""
        # What tells code apart by reading it alone is sure of it within one run, and not from one to the next.
        use = self._use_of(arguments)
        name = None if self._code else lasting_name(self._function, _alike(arguments), key[1], use)
        built = build(use=use, name=name)
        if self._code and self._code(*arguments) != key[-1]:
            raise ProblemError("The code of the system has changed while it was compiled. Run it again.")
        if self._unchanged:
            self._unchanged(*arguments)
        return built

    def _use_of(self, arguments: tuple[Any, ...]) -> Use:
        return self._use if isinstance(self._use, Use) else self._use(*arguments)

    def _compile(
        self, way: "_Way", function: Callable[..., Any], *arguments: Any, use: Use, name: str | None
    ) -> Callable[[], Executable]:
        """Trace a function, unless an earlier run has kept its executable; what is returned compiles it."""
        started = time.perf_counter()
        content = stored.read(name)
        trace = functools.partial(self._traced, way, function, *arguments, use=use, name=name)
        made = trace() if content is None else functools.partial(_loaded, content, arguments, trace)
        spent = time.perf_counter() - started

        def finish() -> Executable:
            started = time.perf_counter()
            found = made()
            with self._lock:
                self.seconds += spent + time.perf_counter() - started
                self.compilations += 1
            executable, read = functools.partial(_run, found.executable), found.results.read
            return lambda *given: read(executable(*given))

        return finish

    def _traced(
        self, way: "_Way", function: Callable[..., Any], *arguments: Any, use: Use, name: str | None
    ) -> Callable[[], stored.Stored]:
        """Trace a function; what is returned compiles it and keeps it for later runs."""
        results: list[Any] = []

        def flat(*arguments: Any) -> list[Array]:
            result = function(*arguments)
            results[:] = [way.of(result)]
            return way.arrays(result)

        lowered = jax.jit(flat).lower(*arguments)

        def finish() -> stored.Stored:
            found = stored.Stored(compiled_for(use, lowered), results[0])
            if name is not None:
                stored.keep(name, lowered, found)
            return found

        return finish


def _loaded(
    content: bytes, arguments: tuple[Any, ...], trace: Callable[[], Callable[[], stored.Stored]]
) -> stored.Stored:
    """What an earlier run has kept, or traced and compiled after all where XLA cannot load it, for whatever reason."""
    try:
        return stored.loaded(content, arguments)
    except Exception:  # XLA, JAX and pickle have no common one
        return trace()()


def compiled_for(use: Use, lowered: jax.stages.Lowered) -> jax.stages.Compiled:
    """Compile what was traced. An XLA that does not know our options goes by its own."""
    try:
        return lowered.compile(compiler_options=use.value if jax.default_backend() == "cpu" else {})
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
        self._key: Hashable | None = None
        self._executable: Executable | None = None

    def is_known(self, last: Any) -> bool:
        """Whether a program of this structure has been made before."""
        self._key = self._find_key(last)
        return self._key in PROGRAMS

    def prepare(self, last: Any) -> Executable:
        """What calls with arguments of this structure run, compiled now if it has not been."""
        if self._executable is None:
            self._executable = self._program(self._key or self._find_key(last), last)()
        return self._executable

    def __call__(self, last: Any) -> Any:
        """The function's value."""
        return self.prepare(last)(*self._given, last)


def _run(executable: Executable, *arguments: Any) -> Any:
    """What an executable gives; numbers that are none where the checks of a library inside stop it.

    The linear solvers of stiff integrators do so where they meet derivatives that are not finite. Given no numbers at
    all, the same executable gives none, in the right shapes.
    """
    try:
        return jax.block_until_ready(executable(*arguments))
    except jax.errors.JaxRuntimeError as error:
        if _CHECKED not in str(error):
            raise
    nothing = jax.tree.map(lambda leaf: jnp.full_like(leaf, jnp.nan) if _is_real(leaf) else leaf, arguments)
    return executable(*nothing)


def _alike(tree: Any) -> Any:
    """A tree whose NumPy arrays, which are traced, stand there by shape and type alone."""
    return jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) if isinstance(leaf, np.ndarray) else leaf, tree
    )


class _Leaves(NamedTuple):
    """A tree of arrays, as they are."""

    structure: Any

    @classmethod
    def of(cls, tree: Any) -> "_Leaves":
        return cls(jax.tree.structure(tree))

    @staticmethod
    def arrays(tree: Any) -> list[Array]:
        return jax.tree.leaves(tree)

    def read(self, arrays: list[jax.Array]) -> Any:
        """The tree of the same arrays."""
        return jax.tree.unflatten(self.structure, arrays)


class _Packed(NamedTuple):
    """A tree of arrays, of which the real ones stand side by side in one vector.

    - `shapes` of the leaves in order, None for those that stand by themselves; `ends` of the others in the vector.
    """

    structure: Any
    shapes: tuple[tuple[int, ...] | None, ...]
    ends: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, tree: Any) -> "_Packed":
        leaves, structure = jax.tree.flatten(tree)
        shapes = tuple(leaf.shape if _is_real(leaf) else None for leaf in leaves)
        sizes = [math.prod(shape) for shape in shapes if shape is not None]
        return cls(structure, shapes, tuple(pairwise(accumulate(sizes, initial=0))))

    @staticmethod
    def arrays(tree: Any) -> list[Array]:
        leaves = jax.tree.leaves(tree)
        vector = jnp.concatenate([jnp.zeros(0), *(jnp.ravel(leaf) for leaf in leaves if _is_real(leaf))])
        return [vector, *(leaf for leaf in leaves if not _is_real(leaf))]

    def read(self, arrays: list[jax.Array]) -> Any:
        """The tree of NumPy arrays."""
        numbers, alone, ends = np.asarray(arrays[0]), iter(arrays[1:]), iter(self.ends)
        leaves = [
            np.asarray(next(alone)) if shape is None else numbers[slice(*next(ends))].reshape(shape)
            for shape in self.shapes
        ]
        return jax.tree.unflatten(self.structure, leaves)


_Way: TypeAlias = type[_Leaves] | type[_Packed]


def _is_real(leaf: Any) -> bool:
    return eqx.is_array(leaf) and leaf.dtype == float
