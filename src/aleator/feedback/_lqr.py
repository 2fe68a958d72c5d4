"""The linear quadratic regulator along a plan: gains by the Riccati differential equation, backwards from its end; and
gains that destabilise, and plans that no gains can stabilise, as the linearised loop at the start of a plan shows.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.lax import stop_gradient
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import numbers_to_arrays
from aleator._core.border import refusal, whole
from aleator._core.compilation import Use, evaluate
from aleator._core.errors import ProblemError
from aleator._core.leaves import stored_numbers
from aleator.dynamics import (
    ONLY_STATES,
    STATES,
    Equations,
    Grid,
    RungeKutta4,
    Start,
    System,
    TracedSystem,
    called,
    derivative,
    initial_state,
)
from aleator.dynamics._grid import sampled
from aleator.dynamics._system import state_type
from aleator.feedback._controllers import AbstractController, Plan
from aleator.trajectories import AbstractSignal, as_array

# Newton's method for the sign of a matrix converges quadratically once it is scaled.
_ITERATIONS = 30
# Entries of a weight on either side of its diagonal, and its least eigenvalue, may differ by rounding.
_SYMMETRIC = 1e-12

Matrix = Float[Array, "n n"]


def linearised(
    rates: Callable[[Array, Array], Array], z: Float[Array, " n"], u: Float[Array, " m"]
) -> tuple[Matrix, Float[Array, "n m"]]:
    """The derivatives of rates by the states and by the inputs."""
    every = jax.jacfwd(lambda both: rates(both[: z.size], both[z.size :]))(jnp.concatenate([z, u]))
    return every[:, : z.size], every[:, z.size :]


def algebraic_riccati(A: Matrix, B: Float[Array, "n m"], Q: Matrix, R: Float[Array, "m m"]) -> Matrix:
    """The stabilising solution of `A' S + S A - S B R⁻¹ B' S + Q = 0`, by the sign of the Hamiltonian (Roberts 1980).

    It is no solution where `(A, B)` cannot be stabilised.
    """
    n = len(A)
    hamiltonian = jnp.block([[A, -B @ jnp.linalg.solve(R, B.T)], [-Q, -A.T]])

    def newton(_: Any, sign: Array) -> Array:
        scale = stop_gradient(jnp.exp(jnp.linalg.slogdet(sign)[1] / (2 * n)))
        return (sign / scale + scale * jnp.linalg.inv(sign)) / 2

    stable = jax.lax.fori_loop(0, _ITERATIONS, newton, hamiltonian) + jnp.eye(2 * n)
    left, right = stable[:, n:], stable[:, :n]
    S = -jnp.linalg.solve(left.T @ left, left.T @ right)
    return (S + S.T) / 2


@final
class LQR(AbstractController):
    """See `lqr`."""

    Q: Any
    R: Any
    final: Any
    steps: int = eqx.field(static=True)

    needs_all: ClassVar[bool] = True

    @override
    def command(self, t: Any, measured: Any, plan: Plan) -> Mapping[str, Any]:
        planned, named = plan.flat
        states = type(plan.states)(**plan.errors(measured))
        return named(planned + plan.schedule @ ravel_pytree(states)[0])

    @override
    def schedule(self, model: Any, inputs: dict[str, AbstractSignal], to: tuple[str, ...]) -> AbstractSignal:
        return Schedule.of(self, model, inputs, to)


def lqr(Q: Any, R: Any, *, final: Any = None, steps: int = 200) -> LQR:
    """Gains of the linear quadratic regulator along the plan, of the model at the means: `K = R⁻¹ B' S` with
    `-S' = A' S + S A - S B R⁻¹ B' S + Q`, `A` and `B` being the derivatives of the rates along the plan.

    - `Q`, `R`: the weights of the states' errors (all states side by side) and of the corrections (all commanded inputs
      side by side): matrices, or their diagonals;
    - `final`: `S` at the end of the plan; by default the stabilising solution of the algebraic equation there, with
      which the gains of a linear system on a constant plan are constant;
    - `steps`: the gains are a table of so many steps, linear between its entries.

    Weights may be decisions. Gains are the output `"lqr.gains"`. Raises `ProblemError` for weights that are none.
    """
    final = None if final is None else _weights("lqr: final", final)
    return LQR(_weights("lqr: Q", Q), _weights("lqr: R", R, is_positive=True), final, whole("lqr: steps", steps))


def _weights(what: str, value: Any, *, is_positive: bool = False) -> Any:
    """A weight as it is stored. Raises `ProblemError` for known numbers that weigh nothing, or reward errors."""
    weights = stored_numbers(what, value)
    if isinstance(weights, np.ndarray | Array):
        matrix = _matrix(np.asarray(weights, dtype=float), np)
        is_square = matrix.ndim == 2 and len(matrix) == matrix.shape[1]
        is_symmetric = is_square and np.allclose(matrix, matrix.T, rtol=_SYMMETRIC, atol=0)
        least = np.linalg.eigvalsh(matrix)[0] if is_symmetric else -np.inf
        if not (least > 0 or (least >= -_SYMMETRIC * np.abs(matrix).max() and not is_positive)):
            sign = "positive" if is_positive else "not negative"
            expected = f"a symmetric matrix whose eigenvalues are {sign}, or its diagonal"
            raise refusal(what, expected, np.asarray(weights).tolist())
    return weights


def _matrix(weights: Any, library: Any = jnp) -> Any:
    """Weights as a matrix: itself, or by its diagonal."""
    return library.diag(weights) if weights.ndim == 1 else library.atleast_2d(weights)


@final
class Schedule(AbstractSignal):
    """The gains over time: they follow from the model and the inputs of a plan, whose equations are traced once.

    `numbers`: those of the law, the model and its inputs, flattened, so that nothing else that changes signals finds
    them; `parts`: the rest of these; `begun`: the states of the loop, side by side, if it begins with others.
    """

    numbers: list[Array]
    parts: Any = eqx.field(static=True)
    to: tuple[str, ...] = eqx.field(static=True)
    equations: Equations = eqx.field(static=True)
    begun: Array | None = None

    @classmethod
    def of(cls, law: LQR, model: System, inputs: dict[str, AbstractSignal], to: tuple[str, ...]) -> "Schedule":
        """That of a realised model; equations do not depend on the instant at which they are traced."""
        values = sampled({**model.signals(), **inputs}, Grid(1.0, 1), np.zeros(1))
        start = Start(jnp.zeros(()), {name: rows[0] for name, rows in values.items()})
        numbers, rest = eqx.partition(numbers_to_arrays((law, model, inputs)), eqx.is_array)
        (leaves, structure), (others, frame) = jax.tree.flatten(numbers), jax.tree.flatten(rest)
        return cls(leaves, (structure, tuple(others), frame), to, Equations.of(model, start))

    def along(self, begun: Array) -> "Schedule":
        """The gains along a plan that begins with other states: those of the loop, side by side."""
        return replace(self, begun=begun)

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        return self.over(0.0, 1.0)(t)

    @override
    def over(self, t_start: Any, t_final: Any) -> "Gains":
        structure, others, frame = self.parts
        rest = jax.tree.unflatten(frame, others)
        law, model, inputs = eqx.combine(jax.tree.unflatten(structure, self.numbers), rest)
        grid = Grid(1.0, 2 * law.steps)
        grid = eqx.tree_at(lambda one: (one.t_start, one.t_final), grid, (t_start, t_final))
        system = TracedSystem(model, self.equations)
        if self.begun is not None:
            n = sum(map(jnp.size, initial_state(model)))
            system = system.beginning(self.begun[n : 2 * n])
        signals = {**system.signals(), **inputs}
        states = RungeKutta4().record(system, grid, signals, ONLY_STATES).history[STATES]
        values = sampled(signals, grid, grid.fractions)
        _, named = ravel_pytree(initial_state(system, grid.times[0], {name: one[0] for name, one in values.items()}))

        def along(t: Array, z: Array, now: dict[str, Array]) -> tuple[Array, Array]:
            u, back = ravel_pytree(tuple(now[name] for name in self.to))

            def rates(z: Array, u: Array) -> Array:
                taken = now | dict(zip(self.to, back(u), strict=True))
                return ravel_pytree(derivative(system, t, named(z), taken))[0]

            return linearised(rates, z, u)

        A, B = jax.vmap(along)(grid.times, states, values)
        Q, R = (_matrix(as_array(one)) for one in (law.Q, law.R))
        final = None if law.final is None else _matrix(as_array(law.final))
        n, m = B.shape[1:]
        for name, one, size, of in (("Q", Q, n, "states"), ("R", R, m, "inputs"), ("final", final, n, "states")):
            if one is not None and one.shape != (size, size):
                raise ProblemError(f"lqr: {name}: expected weights of {size} {of}; received the shape {one.shape}.")
        h = 2 * grid.step

        def back_in_time(S: Array, A: Array, B: Array) -> Array:
            return A.T @ S + S @ A - S @ B @ jnp.linalg.solve(R, B.T @ S) + Q

        def step(S: Array, rows: tuple[Array, Array]) -> tuple[Array, Array]:
            A, B = rows  # at the later end, the middle and the earlier end
            slopes = [back_in_time(S, A[0], B[0])]
            for share, place in ((0.5, 1), (0.5, 1), (1.0, 2)):
                slopes.append(back_in_time(S + share * h * slopes[-1], A[place], B[place]))
            S = S + h / 6 * (slopes[0] + 2 * slopes[1] + 2 * slopes[2] + slopes[3])
            return S, S

        last = algebraic_riccati(A[-1], B[-1], Q, R) if final is None else final
        rows = jax.tree.map(lambda one: jnp.stack([one[2::2], one[1::2], one[:-1:2]], axis=1), (A, B))
        _, earlier = jax.lax.scan(step, last, rows, reverse=True)
        S = jnp.concatenate([earlier, last[None]])
        gains = jax.vmap(lambda S, B: jnp.linalg.solve(R, B.T @ S))(S, B[::2])
        return Gains(gains, t_start, t_final)


@final
class Gains(AbstractSignal):
    """A table of gains, linear between its entries."""

    rows: Float[Array, "instants m n"]
    t_start: Any
    t_final: Any

    @override
    def over(self, t_start: Any, t_final: Any) -> "Gains":
        return self

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "m n"]:
        steps = len(self.rows) - 1
        place = steps * (t - self.t_start) / (self.t_final - self.t_start)
        first = jnp.clip(jnp.floor(stop_gradient(place)).astype(int), 0, steps - 1)
        share = place - first
        return (1 - share) * self.rows[first] + share * self.rows[first + 1]


# A mode that grows by a smaller part of the fastest rate is at rest.
_GROWTH = 1e-6


def _linear_loop(
    names: Any, law: AbstractController, model: System, inputs: dict[str, AbstractSignal], grid: Grid
) -> tuple[Float[Array, "n n"], Float[Array, "n m"], Float[Array, "m n"]]:
    """The derivatives of the rates by states and commanded inputs, and of these by the states, at the start."""
    (of, to), t = names, grid.times[0]
    values = sampled({**model.signals(), **inputs}, grid, grid.fractions[:1])
    now = {name: rows[0] for name, rows in values.items()}
    start = initial_state(model, t, now)
    plan = Plan(start, now, lambda z, inputs: derivative(model, t, z, inputs), to)
    (z, named), (u, commanded) = ravel_pytree(start), plan.flat

    def rates(z: Array, u: Array) -> Array:
        return ravel_pytree(plan.rates(named(z), now | commanded(u)))[0]

    def command(z: Array) -> Array:
        measured = state_type(of)(**{name: getattr(named(z), name) for name in of})
        values = called(law, law.command, t, measured, plan)
        return ravel_pytree(tuple(jnp.asarray(values[name], dtype=float) for name in to))[0]

    return *linearised(rates, z, u), jnp.zeros((u.size, z.size)) if isinstance(law, LQR) else jax.jacfwd(command)(z)


def unstable(
    law: AbstractController,
    model: System,
    inputs: dict[str, AbstractSignal],
    grid: Grid,
    of: tuple[str, ...],
    to: tuple[str, ...],
) -> str:
    """That errors grow faster than without feedback, or that no gains hinder it; empty if neither is so.

    `inputs`: of the plan.
    """
    loop = evaluate(partial(_linear_loop, (of, to)), law, model, inputs, grid, use=Use.BRIEF)
    A, B, K = map(np.asarray, loop)
    if isinstance(law, LQR):
        if law.final is not None or _can_be_stabilised(A, B):
            return ""
        return (
            f"al.lqr: expected a plan that {', '.join(to)} can stabilise; received one with a mode, at its start, that "
            "does not decay and that no such input moves. Give final=, the weight at the end."
        )
    loop = np.linalg.eigvals(A + B @ K)
    growth, before = loop.real.max(), max(np.linalg.eigvals(A).real.max(), 0.0)
    if growth <= before + _GROWTH * np.abs(loop).max():
        return ""
    return (
        f"Feedback: its gains destabilise: at the start of the plan errors grow by {growth:.3g} 1/s with them, and by "
        f"{before:.3g} 1/s without. Change a sign, or add a gain of a rate: gains multiply the plan minus what is "
        "measured, and the product is added to the planned input."
    )


def _can_be_stabilised(A: np.ndarray, B: np.ndarray) -> bool:
    """Whether inputs reach every mode that does not decay (Hautus)."""
    size = max(np.abs(A).max(initial=0.0), np.abs(B).max(initial=0.0))
    modes = (value for value in np.linalg.eigvals(A) if value.real >= -_GROWTH * size)
    return all(np.linalg.matrix_rank(np.hstack([A - value * np.eye(len(A)), B])) == len(A) for value in modes)
