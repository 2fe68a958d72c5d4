"""A scaled program as CasADi's callbacks: each writes parts of the cached evaluation into CasADi's buffers."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from aleator.nlp._evaluations import HaltedError, NotFiniteError
from aleator.nlp._scaling import ScaledProgram

Answered = Callable[[list[np.ndarray]], Sequence[np.ndarray]]


def callbacks_of(casadi: Any, scaled: ScaledProgram) -> dict[str, Any]:
    """The functions that IPOPT calls: `f`, `grad_f`, and `g`, `jac_g`, `hess_lag` if the program has them.

    CasADi keeps no references to them: keep them alive as long as the solver.
    """
    n, m = scaled.size, scaled.rows
    point, number = casadi.Sparsity.dense(n, 1), casadi.Sparsity.dense(1, 1)
    nothing = casadi.Sparsity.dense(0, 0)
    callback = _callback_class(casadi)

    def parts(*names: str) -> Answered:
        return lambda given: [np.ravel(getattr(scaled.evaluate(given[0]), name)) for name in names]

    found = {
        "f": callback("objective", [point], [number], parts("objective")),
        "grad_f": callback("gradient", [point, nothing], [number, point], parts("objective", "gradient")),
    }
    if m:
        rows = casadi.Sparsity.dense(m, 1)
        sparsity, ordered = _by_columns(casadi, scaled)

        def jacobian(given: list[np.ndarray]) -> Sequence[np.ndarray]:
            evaluation = scaled.evaluate(given[0])
            return evaluation.constraints, ordered(evaluation.jacobian)

        found["g"] = callback("constraints", [point], [rows], parts("constraints"))
        found["jac_g"] = callback("jacobian", [point, nothing], [rows, sparsity], jacobian)
    if scaled.curved is not None:
        # The lower triangle by rows is the upper one by columns, which CasADi expects.
        upper = casadi.Sparsity(n, n, scaled.curved.indptr.tolist(), scaled.curved.indices.tolist())
        multipliers = casadi.Sparsity.dense(m, 1)

        def hessian(given: list[np.ndarray]) -> Sequence[np.ndarray]:
            return (scaled.hessian(given[0], float(given[2][0]), given[3]),)

        found["hess_lag"] = callback("hessian", [point, nothing, number, multipliers], [upper], hessian)
    return found


def _by_columns(casadi: Any, scaled: ScaledProgram) -> tuple[Any, Callable[[Any], np.ndarray]]:
    """The sparsity of the Jacobian, and a function that orders its entries column by column, as CasADi needs them."""
    entries = scaled.sparsity
    if isinstance(entries, np.ndarray):
        return casadi.Sparsity.dense(scaled.rows, scaled.size), lambda jacobian: np.ravel(jacobian, order="F")
    numbered = entries.astype(float)
    numbered.data = np.arange(entries.nnz, dtype=float)
    columns = numbered.tocsc()
    columns.sort_indices()
    order = columns.data.astype(int)
    sparsity = casadi.Sparsity(scaled.rows, scaled.size, columns.indptr.tolist(), columns.indices.tolist())
    return sparsity, lambda jacobian: jacobian.data[order]


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
