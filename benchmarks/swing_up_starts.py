"""Where the searches of the swing-up start: many swings at random, screened by simulation, then searched from the best.

    python benchmarks/swing_up_starts.py [minutes] [seed]

Prints each better plan with its control points. Most searches end at other local optima or nowhere.
"""

import sys
import time
import warnings

import jax
import jax.numpy as jnp
import numpy as np

import aleator as al
from aleator.design import functionals_of
from aleator.studies import swing_up
from aleator.transcription import AbstractTranscribed, scope_of, transcribe

CANDIDATES, KEPT, TOGETHER = 20_000, 1000, 500


def swings(count: int, generator: np.random.Generator) -> np.ndarray:
    """Control points and durations of random swings: a late rise, and waves that all end in it."""
    fractions = np.linspace(0.0, 1.0, 80)
    bare = al.BSpline(np.zeros(swing_up.FREE), degree=swing_up.DEGREE, **swing_up.ENDS)
    basis = np.stack([al.BSpline(one, degree=swing_up.DEGREE).values(fractions) for one in np.eye(bare.count)], axis=1)
    inner = np.linalg.pinv(basis[:, 2:-2])
    waves = np.sin(np.pi * np.arange(1, 6)[:, None] * fractions)
    widths = (
        generator.uniform(-2.5, 2.5, (count, 5)) / np.arange(1, 6) ** 0.7 * (generator.uniform(size=(count, 5)) < 0.7)
    )
    rise = -np.pi * (1 - fractions ** generator.uniform(1, 6, (count, 1)))
    points = (rise + widths @ waves - np.asarray(bare.values(fractions))) @ inner.T
    return np.column_stack([np.clip(points, -12, 12), generator.uniform(2.0, 7.9, count)])


def screened(transcription: AbstractTranscribed, candidates: np.ndarray) -> np.ndarray:
    """The candidates in order of how far they are from what is asked."""
    problem = transcription.problem

    def far(x: jax.Array) -> jax.Array:
        functionals = functionals_of(problem.expressions)
        scope = scope_of(problem, functionals, transcription.collocation, transcription.constants, x)
        energy, *values = (one.evaluate(scope) for one in problem.expressions)
        beyond = [
            jnp.mean(jnp.maximum(jnp.maximum(value - one.upper, one.lower - value), 0.0))
            for one, value in zip(problem.constraints, values, strict=True)
        ]
        return sum(beyond, start=0.03 * jnp.maximum(energy - 27.0, 0.0))

    each = jax.jit(jax.vmap(far))
    found = np.concatenate([np.asarray(each(jnp.asarray(some))) for some in candidates.reshape(-1, TOGETHER, 13)])
    return candidates[np.argsort(np.nan_to_num(found, nan=np.inf))]


def main() -> None:
    """Search for the mean pendulum, then for the family, half of the time each."""
    minutes, seed = (float(given) for given in (*sys.argv[1:], "10", "0")[:2])
    warnings.simplefilter("ignore")
    generator = np.random.default_rng(int(seed))
    kept = swings(CANDIDATES, generator)
    for name, problem in (("mean", swing_up.deterministic_problem()), ("family", swing_up.robust_problem())):
        kept = screened(transcribe(problem), kept)[:KEPT]
        ends, best = time.time() + 30 * minutes, np.inf
        for x in kept:
            if time.time() > ends:
                break
            start = {"motion.q1.free": x[:-1], "t_final": x[-1]}
            found = al.solve(problem, al.solvers.FilterSQP(max_iterations=120), start=start, between=1, throw=False)
            if found.certificate.violation < 1e-6 and found.objective < best:
                best = found.objective
                print(f"{name}: {best:.4f} J ({found.status.value})", np.round(found.vector, 4).tolist(), flush=True)


if __name__ == "__main__":
    main()
