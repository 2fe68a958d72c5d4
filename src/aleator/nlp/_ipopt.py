"""IPOPT through CasADi's wheel: for many variables, and for platforms without a wheel of unopy."""

import functools
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from typing_extensions import override

from aleator.nlp._evaluations import HaltedError, NotFiniteError
from aleator.nlp._local_solver import AbstractLocalSolver
from aleator.nlp._matrices import Pattern
from aleator.nlp._scaling import Multipliers, ScaledProgram
from aleator.nlp._solver import Status
from aleator.nlp._verdict import HELD, Answer

Answered = Callable[[list[np.ndarray]], Sequence[Any]]


# Read when the linear algebra of CasADi's wheel is loaded.
_THREADS = "OPENBLAS_NUM_THREADS"


@functools.cache
def _load() -> None:
    """Load IPOPT with one thread of linear algebra, unless the user's environment says how many.

    Threads that wait for each other at every small product make a solution up to 50 times as long, and digits depend on
    their number.
    """
    import casadi

    given = os.environ.get(_THREADS)
    os.environ.setdefault(_THREADS, "1")
    try:
        casadi.load_nlpsol("ipopt")
    finally:
        if given is None:
            del os.environ[_THREADS]


def _functions(casadi: Any, scaled: ScaledProgram) -> tuple[dict[str, Any], dict[str, Any], tuple[Any, ...]]:
    """The program and its derivatives as IPOPT takes them, and the callbacks, to which CasADi keeps no references: keep
    them alive as long as the solver.
    """
    n, m, callback = scaled.size, scaled.rows, _callback_class(casadi)
    # A dense sparsity is a guess, and IPOPT takes what it is told.
    pattern = Pattern(np.ones((m, n)) if isinstance(scaled.sparsity, np.ndarray) else scaled.sparsity)
    point, number, rows = casadi.Sparsity.dense(n, 1), casadi.Sparsity.dense(1, 1), casadi.Sparsity.dense(m, 1)
    entries = casadi.Sparsity.triplet(m, n, pattern.rows.tolist(), pattern.columns.tolist())

    def evaluated(given: list[np.ndarray]) -> Sequence[Any]:
        here = scaled.evaluate(given[0])
        return here.objective, here.gradient, here.constraints, pattern.entries(here.jacobian)

    z, nothing = casadi.MX.sym("z", n), casadi.MX.sym("p", 0, 0)
    evaluate = callback("evaluate", [point], [number, point, rows, entries], evaluated)
    objective, gradient, constraints, jacobian = evaluate(z)
    derivatives = {
        "grad_f": casadi.Function("grad_f", [z, nothing], [objective, gradient]),
        "jac_g": casadi.Function("jac_g", [z, nothing], [constraints, jacobian]),
    }
    if scaled.curved is not None:
        # The lower triangle by rows is the upper one by columns, which CasADi expects.
        upper = casadi.Sparsity(n, n, scaled.curved.indptr.tolist(), scaled.curved.indices.tolist())

        def curved(given: list[np.ndarray]) -> Sequence[Any]:
            return (scaled.hessian(given[0], float(given[2][0]), given[3]),)

        derivatives["hess_lag"] = callback("hessian", [point, nothing.sparsity(), number, rows], [upper], curved)
    return {"x": z, "f": objective, "g": constraints}, derivatives, (evaluate, derivatives.get("hess_lag"))


def _callback_class(casadi: Any) -> Any:
    class Answering(casadi.Callback):
        """A callback. CasADi asks for its shapes during construction, so they are set before `construct`."""

        def __init__(self, name: str, inputs: list[Any], outputs: list[Any], answered: Answered):
            super().__init__()
            self._inputs, self._outputs, self._answered = inputs, outputs, answered
            self.construct(name, {})

        def get_n_in(self) -> int:
            return len(self._inputs)

        def get_n_out(self) -> int:
            return len(self._outputs)

        def get_sparsity_in(self, index: int) -> Any:
            return self._inputs[index]

        def get_sparsity_out(self, index: int) -> Any:
            return self._outputs[index]

        def has_eval_buffer(self) -> bool:
            return True

        def eval_buffer(self, arguments: tuple[Any, ...], results: tuple[Any, ...]) -> int:
            # CasADi passes None for inputs that are zero or empty, and for outputs that are not needed.
            given = [
                np.zeros(sparsity.nnz()) if one is None else np.frombuffer(one)
                for one, sparsity in zip(arguments, self._inputs, strict=True)
            ]
            try:
                answers = self._answered(given)
            except (NotFiniteError, HaltedError):
                # IPOPT takes a nonzero code as "cannot be evaluated here".
                return 1
            for answer, buffer in zip(answers, results, strict=True):
                if buffer is not None:
                    np.frombuffer(buffer)[:] = answer
            return 0

    return Answering


_CLAIMS = {
    "Solve_Succeeded": Status.SOLVED,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Maximum_Iterations_Exceeded": Status.ITERATION_LIMIT,
}
# The codes of orderings in MUMPS. The second takes a quarter of the time for 50 states in a row, and nearly twice the
# time for four; the least breadth of chains that are ordered by it.
_APPROXIMATE_MINIMUM_DEGREE, _NESTED_DISSECTION, _BROAD = 0, 5, 32
# By how many percent the workspace of MUMPS exceeds its estimate; by default tenfold, which takes longer to allot than
# to use. IPOPT doubles it where it does not suffice.
_WORKSPACE = 50
# Limits hold at rough answers too, by as much as is certified. The least barrier over the tolerance.
_HOLDS, _LEAST_BARRIER = 1e-2 * HELD, 0.1


@final
@dataclass(frozen=True)
class Ipopt(AbstractLocalSolver):
    """The primal-dual interior-point method with a filter line search.

    The Hessian is the program's own if it has one, else a limited-memory BFGS approximation.
    Wächter and Biegler 2006, "On the implementation of an interior-point filter line-search algorithm for
    large-scale nonlinear programming". Points that cannot be evaluated shorten the step.

    - `tolerance`, `max_iterations`: see `AbstractLocalSolver`.
    """

    @property
    @override
    def name(self) -> str:
        import casadi

        return f"IPOPT (CasADi {casadi.CasadiMeta.version()})"

    @override
    def minimise(self, scaled: ScaledProgram, multipliers: np.ndarray | None) -> Answer:
        import casadi

        program, derivatives, callbacks = _functions(casadi, scaled)
        _load()
        options = self._options(scaled, warm=multipliers is not None) | derivatives
        solver = casadi.nlpsol("ipopt", "ipopt", program, options)
        arguments = {"x0": scaled.start, "lbx": scaled.lower, "ubx": scaled.upper}
        arguments |= dict(zip(("lbg", "ubg"), scaled.relaxed(self.aim), strict=True))
        if multipliers is not None:
            # Those of the bounds make the Lagrangian stationary at the start.
            start = scaled.evaluate(scaled.start)
            remainder = -(start.gradient + multipliers @ start.jacobian)
            allowed = np.where(remainder > 0, np.isfinite(scaled.upper), np.isfinite(scaled.lower))
            arguments |= {"lam_x0": np.where(allowed, remainder, 0.0), "lam_g0": multipliers}
        found = {name: np.array(part.full(), dtype=float).ravel() for name, part in solver(**arguments).items()}
        stats = solver.stats()
        del callbacks
        status = str(stats["return_status"])
        return Answer(
            claim=_CLAIMS.get(status, Status.FAILED),
            point=found["x"],
            multipliers=Multipliers(found["lam_g"], found["lam_x"]),
            iterations=int(stats.get("iter_count", 0)),
            message=status.replace("_", " ").lower(),
        )

    def _options(self, scaled: ScaledProgram, warm: bool) -> dict[str, Any]:
        options = {
            # CasADi needs no derivatives beyond those passed in.
            "no_nlp_grad": True,
            "print_time": False,
            "show_eval_warnings": False,
            "error_on_fail": False,
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "ipopt.hessian_approximation": "limited-memory" if scaled.curved is None else "exact",
            "ipopt.mu_strategy": "adaptive",
            "ipopt.tol": self.aim,
            "ipopt.constr_viol_tol": min(self.aim, _HOLDS),
            # Smaller barriers leave a tolerance met, and let the active set change in many short steps.
            "ipopt.mu_min": _LEAST_BARRIER * self.aim,
            "ipopt.max_iter": self.max_iterations,
            # The program is scaled already, and the model must not be evaluated outside the variables' bounds.
            "ipopt.nlp_scaling_method": "none",
            "ipopt.bound_relax_factor": 0.0,
            "ipopt.mumps_mem_percent": _WORKSPACE,
        }
        if scaled.curved is not None:
            # MUMPS's default ordering takes most of the time if many rows share a variable.
            is_broad = scaled.program.breadth >= _BROAD
            options["ipopt.mumps_pivot_order"] = _NESTED_DISSECTION if is_broad else _APPROXIMATE_MINIMUM_DEGREE
        if warm:
            options |= {"ipopt.warm_start_init_point": "yes", "ipopt.mu_init": 1e-6}
            pushes = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
            options |= {f"ipopt.warm_start_{push}": 1e-8 for push in pushes}
        return options
