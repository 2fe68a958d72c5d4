"""IPOPT through CasADi's wheel: for many variables, and for platforms without a wheel of unopy."""

from dataclasses import dataclass
from typing import Any, final

import numpy as np
from typing_extensions import override

from aleator.nlp._answer import Answer
from aleator.nlp._casadi import callbacks_of
from aleator.nlp._local_solver import AbstractLocalSolver
from aleator.nlp._outcome import Status
from aleator.nlp._scales import Multipliers
from aleator.nlp._scaling import ScaledProgram

_CLAIMS = {
    "Solve_Succeeded": Status.SOLVED,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Maximum_Iterations_Exceeded": Status.ITERATION_LIMIT,
}
# The code of this ordering in MUMPS.
_APPROXIMATE_MINIMUM_DEGREE = 0


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

        z = casadi.MX.sym("z", scaled.size)
        # CasADi keeps no references to the callbacks, so this list must outlive the solver.
        callbacks = callbacks_of(casadi, scaled)
        program = {"x": z, "f": callbacks["f"](z)}
        options = self._options(scaled, warm=multipliers is not None)
        options["grad_f"] = callbacks["grad_f"]
        if scaled.rows:
            program["g"] = callbacks["g"](z)
            options["jac_g"] = callbacks["jac_g"]
        if "hess_lag" in callbacks:
            options["hess_lag"] = callbacks["hess_lag"]
        solver = casadi.nlpsol("ipopt", "ipopt", program, options)
        arguments = {"x0": scaled.start, "lbx": scaled.lower, "ubx": scaled.upper}
        if scaled.rows:
            slack = self._equality_slack(scaled)
            arguments |= {"lbg": scaled.constraint_lower - slack, "ubg": scaled.constraint_upper + slack}
        if multipliers is not None:
            arguments |= _warm(scaled, multipliers)
        return _answer(solver(**arguments), solver.stats())

    def _equality_slack(self, scaled: ScaledProgram) -> np.ndarray | float:
        """Relax equalities within the tolerance if they outnumber the variables, which IPOPT would refuse."""
        equal = scaled.constraint_lower == scaled.constraint_upper
        return np.where(equal, self.aim, 0.0) if equal.sum() > scaled.size else 0.0

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
            "ipopt.constr_viol_tol": self.aim,
            "ipopt.max_iter": self.max_iterations,
            # The program is scaled already, and the model must not be evaluated outside the variables' bounds.
            "ipopt.nlp_scaling_method": "none",
            "ipopt.bound_relax_factor": 0.0,
        }
        if scaled.curved is not None:
            # MUMPS's default ordering takes most of the time if many rows share a variable.
            options["ipopt.mumps_pivot_order"] = _APPROXIMATE_MINIMUM_DEGREE
        if warm:
            options |= {"ipopt.warm_start_init_point": "yes", "ipopt.mu_init": 1e-6}
            pushes = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
            options |= {f"ipopt.warm_start_{push}": 1e-8 for push in pushes}
        return options


def _warm(scaled: ScaledProgram, multipliers: np.ndarray) -> dict[str, np.ndarray]:
    """Initial multipliers; those of the bounds make the Lagrangian stationary at the start."""
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
