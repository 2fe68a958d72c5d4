"""A population that spreads over a whole front."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from aleator._core.errors import MissingExtraError

# Points of a generation for each point of the front that is asked for, and the fewest.
_EACH, _FEWEST = 2, 40
# In the place of values that are not finite: worse than all others.
_WORST = 1e30


def load_pymoo(who: str) -> tuple[Any, Any]:
    """NSGA-II and the base of problems, imported late. Raises `MissingExtraError` if pymoo is not installed."""
    try:
        from pymoo.algorithms.moo.nsga2 import NSGA2
        from pymoo.core.problem import Problem
    except ImportError as error:
        raise MissingExtraError(
            f"{who} needs the library pymoo: install it with `pip install 'aleator[fronts]'`."
        ) from error
    return NSGA2, Problem


def population_front(
    values: Callable[[Float[np.ndarray, "k n"]], tuple[np.ndarray, np.ndarray]],
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
    first: Float[np.ndarray, "some n"],
    *,
    points: int,
    evaluations: int,
    seed: int,
    heed: Callable[[int], None],
) -> Float[np.ndarray, "found n"]:
    """Points between bounds of which none is better in all wishes, by NSGA-II (Deb et al. 2002) of pymoo.

    - `values`: of whole generations: the wishes, shape (k, wishes), and the largest violations, shape (k,);
    - `first`: points of the first generation, the others are uniform; `points`: of the front that are asked for;
    - `heed`: called with the evaluations done before each generation; what it raises ends the search.
    """
    algorithm_of, base = load_pymoo("A population on a front")
    size = max(_EACH * points, _FEWEST)
    generator = np.random.default_rng(seed)
    uniform = generator.uniform(lower, upper, (max(size - len(first), 0), lower.size))
    count = len(values(first[:1])[0][0])
    problem = base(n_var=lower.size, n_obj=count, n_ieq_constr=1, xl=lower, xu=upper)
    algorithm = algorithm_of(pop_size=size, sampling=np.concatenate([first, uniform])[:size])
    algorithm.setup(problem, seed=seed, verbose=False)
    done = 0
    while done < evaluations:
        heed(done)
        asked = algorithm.ask()
        wishes, violations = values(np.clip(asked.get("X"), lower, upper))
        asked.set("F", np.nan_to_num(wishes, nan=_WORST, posinf=_WORST))
        asked.set("G", np.nan_to_num(violations, nan=_WORST, posinf=_WORST)[:, None])
        for one in asked:
            one.evaluated.update({"F", "G"})
        algorithm.tell(infills=asked)
        done += len(asked)
    return np.atleast_2d(algorithm.opt.get("X"))
