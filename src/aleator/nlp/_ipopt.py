"""IPOPT through CasADi's wheel: many decisions, or where unopy has no wheel."""

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from aleator.nlp._evaluations import HaltedError, NotFiniteError
from aleator.nlp._outcome import Status
from aleator.nlp._scaling import Multipliers, ScaledProgram
from aleator.nlp._solver import AbstractSolver
from aleator.nlp._verdict import Answer

_CLAIMS = {
    "Solve_Succeeded": Status.SOLVED,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Maximum_Iterations_Exceeded": Status.ITERATION_LIMIT,
}


@final
@dataclass(frozen=True)
class Ipopt(AbstractSolver):
    """Primal-dual interior points with a filter line search, limited-memory BFGS Hessian.

    Wächter and Biegler 2006, "On the implementation of an interior-point filter line-search algorithm for
    large-scale nonlinear programming". Points that cannot be evaluated shorten the step.
    """

    def _name(self) -> str:
        import casadi

        return f"IPOPT (CasADi {casadi.CasadiMeta.version()})"

    def _minimise(self, scaled: ScaledProgram, multipliers: np.ndarray | None) -> Answer:
        import casadi

        z = casadi.MX.sym("z", scaled.size)
        # The callbacks die with their last Python reference, so this list must outlive the solver.
        callbacks = _callbacks(casadi, scaled)
        program = {"x": z, "f": callbacks["f"](z)}
        options = self._options(warm=multipliers is not None)
        options["grad_f"] = callbacks["grad_f"]
        if scaled.rows:
            program["g"] = callbacks["g"](z)
            options["jac_g"] = callbacks["jac_g"]
        solver = casadi.nlpsol("ipopt", "ipopt", program, options)
        arguments = {"x0": scaled.start, "lbx": scaled.lower, "ubx": scaled.upper}
        if scaled.rows:
            slack = self._equality_slack(scaled)
            arguments |= {"lbg": scaled.constraint_lower - slack, "ubg": scaled.constraint_upper + slack}
        if multipliers is not None:
            arguments |= _warm(scaled, multipliers)
        return _answer(solver(**arguments), solver.stats())

    def _equality_slack(self, scaled: ScaledProgram) -> np.ndarray | float:
        """Widen equalities that outnumber the decisions, which IPOPT would refuse, within the tolerance."""
        equal = scaled.constraint_lower == scaled.constraint_upper
        return np.where(equal, self.aim, 0.0) if equal.sum() > scaled.size else 0.0

    def _options(self, warm: bool) -> dict[str, Any]:
        options = {
            # The Hessian is approximated, so CasADi needs no derivatives beyond those handed over.
            "no_nlp_grad": True,
            "print_time": False,
            "show_eval_warnings": False,
            "error_on_fail": False,
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "ipopt.hessian_approximation": "limited-memory",
            "ipopt.mu_strategy": "adaptive",
            "ipopt.tol": self.aim,
            "ipopt.constr_viol_tol": self.aim,
            "ipopt.max_iter": self.max_iterations,
            # The program is scaled already, and the model must not be asked outside the decisions' bounds.
            "ipopt.nlp_scaling_method": "none",
            "ipopt.bound_relax_factor": 0.0,
        }
        if warm:
            options |= {"ipopt.warm_start_init_point": "yes", "ipopt.mu_init": 1e-6}
            pushes = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
            options |= {f"ipopt.warm_start_{push}": 1e-8 for push in pushes}
        return options


def _warm(scaled: ScaledProgram, multipliers: np.ndarray) -> dict[str, np.ndarray]:
    """Multipliers to begin with; the bounds' ones make the Lagrangian stationary at the start."""
    start = scaled.evaluate(scaled.start)
    remainder = -(start.gradient + multipliers @ start.jacobian)
    allowed = np.where(remainder > 0, np.isfinite(scaled.upper), np.isfinite(scaled.lower))
    guess = {"lam_x0": np.where(allowed, remainder, 0.0)}
    return guess | ({"lam_g0": multipliers} if scaled.rows else {})


def _answer(solution: Any, stats: dict[str, Any]) -> Answer:
    status = str(stats["return_status"])
    return Answer(
        claim=_CLAIMS.get(status, Status.FAILED),
        point=_vector(solution["x"]),
        multipliers=Multipliers(_vector(solution["lam_g"]), _vector(solution["lam_x"])),
        iterations=int(stats.get("iter_count", 0)),
        message=status.replace("_", " ").lower(),
    )


def _vector(matrix: Any) -> np.ndarray:
    return np.array(matrix.full(), dtype=float).ravel()


def _callbacks(casadi: Any, scaled: ScaledProgram) -> dict[str, Any]:
    """Make the functions that IPOPT asks for; each writes parts of the cached evaluation into CasADi's buffers."""

    class Values(casadi.Callback):
        """CasADi asks for the shapes of a subclass while it constructs it, so they are set before `construct`."""

        def __init__(self, name: str, inputs: list[tuple[int, int]], outputs: dict[str, tuple[int, int]]):
            super().__init__()
            self._inputs, self._outputs = inputs, outputs
            self.construct(name, {})

        def get_n_in(self) -> int:
            return len(self._inputs)

        def get_n_out(self) -> int:
            return len(self._outputs)

        def get_sparsity_in(self, index: int) -> Any:
            return casadi.Sparsity.dense(*self._inputs[index])

        def get_sparsity_out(self, index: int) -> Any:
            return casadi.Sparsity.dense(*list(self._outputs.values())[index])

        def has_eval_buffer(self) -> bool:
            return True

        def eval_buffer(self, arguments: tuple[Any, ...], results: tuple[Any, ...]) -> int:
            try:
                evaluation = scaled.evaluate(np.frombuffer(arguments[0]))
            except (NotFiniteError, HaltedError):
                # A nonzero code is what IPOPT takes as "cannot be evaluated here".
                return 1
            for part, buffer in zip(self._outputs, results, strict=True):
                # CasADi passes None for an output that nobody needs.
                if buffer is not None:
                    np.frombuffer(buffer)[:] = np.ravel(getattr(evaluation, part), order="F")
            return 0

    n, m = scaled.size, scaled.rows
    point, with_parameters = [(n, 1)], [(n, 1), (0, 0)]
    value, gradient = {"objective": (1, 1)}, {"gradient": (n, 1)}
    callbacks = {
        "f": Values("objective", point, value),
        "grad_f": Values("gradient", with_parameters, value | gradient),
    }
    if m:
        rows, jacobian = {"constraints": (m, 1)}, {"jacobian": (m, n)}
        callbacks["g"] = Values("constraints", point, rows)
        callbacks["jac_g"] = Values("jacobian", with_parameters, rows | jacobian)
    return callbacks
