"""Intrusive Galerkin projection (equations 20 to 22): all coefficients are integrated or solved for together."""

import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from typing_extensions import override

from aleator._core.arrays import Pytree, numbers_to_arrays
from aleator._core.compilation import Use
from aleator._core.errors import ExpansionWarning, ProblemError, SimulationError
from aleator._core.given import one_of, refusal
from aleator._core.leaves import transparent
from aleator._core.tracing import evaluate
from aleator.analysis._expanded import Expanded
from aleator.analysis._galerkin_equations import projected_outputs, unsolved_node
from aleator.analysis._projection import Quadrature, quadrature_over
from aleator.dynamics import (
    AbstractIntegrator,
    AlgebraicSystem,
    Grid,
    System,
    check_inputs,
    derivative,
    initial_state,
    observation,
    simulate,
)
from aleator.ensemble import concrete
from aleator.expansion import Adaptive, Basis, Expansion
from aleator.trajectories import AbstractSignal
from aleator.uncertainty import placements, realise


@transparent("system")
class _Model(NamedTuple):
    """The parts of a simulation that may hold distributions."""

    system: System | AlgebraicSystem
    inputs: dict[str, AbstractSignal]


@final
class GalerkinSystem(System):
    """A system whose states are the coefficients of another system's states, of shape (terms, *shape) each.

    - `realised`: system and inputs at each quadrature node, with a leading axis for the nodes;
    - `quadrature`: projects the rates and outputs at the nodes onto the polynomials.
    """

    states: tuple[str, ...] = eqx.field(static=True)  # type: ignore[assignment, misc]
    realised: Pytree
    quadrature: Quadrature

    def rhs(self, t: Any, z: Any) -> tuple[Array, ...]:
        """The rates of the coefficients: `<Psi_n, f(sum_j x_j Psi_j, theta)>`, equation (22)."""
        return tuple(self._projected(derivative, t, z))

    def outputs(self, t: Any, z: Any) -> dict[str, Array]:
        """The coefficients of the outputs."""
        return self._projected(observation, t, z)

    @override
    def starting(self, t: Any, inputs: Mapping[str, Any]) -> dict[str, Array]:
        """The coefficients of the initial state."""
        del inputs

        def at_node(model: _Model) -> Any:
            assert isinstance(model.system, System)
            return initial_state(model.system, t, {name: signal(t) for name, signal in model.inputs.items()})

        return jax.tree.map(self.quadrature.project, eqx.filter_vmap(at_node)(self.realised))._asdict()

    def _projected(self, function: Any, t: Any, z: Any) -> Any:
        """The coefficients of `function(system, t, z, inputs)`."""

        def at_node(model: _Model, state: Any) -> Any:
            return function(model.system, t, state, {name: signal(t) for name, signal in model.inputs.items()})

        states = jax.tree.map(self.quadrature.at_nodes, z)
        return jax.tree.map(self.quadrature.project, eqx.filter_vmap(at_node)(self.realised, states))


def galerkin(
    system: System | AlgebraicSystem,
    grid: Grid | None = None,
    expansion: Expansion | None = None,
    inputs: Mapping[str, AbstractSignal] | None = None,
    integrator: AbstractIntegrator | None = None,
) -> Expanded:
    """Expand all outputs of an uncertain system by intrusive Galerkin projection, equation (22).

    - `system`: a `System`, whose outputs are histories on `grid`, or an `AlgebraicSystem`, which takes neither grid nor
      inputs;
    - `inputs`: signals by name; `integrator`: of the coefficients;
    - `expansion`: order and index set, and the quadrature if its points are `GaussPoints` or `SmolyakPoints`; the
      default is a full Gauss grid that integrates products of three polynomials of the basis.

    Returns an `Expanded` without samples. For a `System` the coefficients of all states are integrated as one large
    system, whose right-hand side (21) is projected by quadrature at each evaluation. For an `AlgebraicSystem` the
    coefficients of all unknowns solve the projected equations (20), `<Psi_n, A(sum_j rho_j Psi_j, theta)> = 0`, by
    Newton's method. Both converge to the result of `expand`, which is cheaper for many variables; as a check they share
    neither points nor fit with it.

    Raises `ProblemError` if nothing is uncertain or the quadrature is too large, `SimulationError` if the coefficients
    diverge or the projected equations have no solution. Warns with `ExpansionWarning` if the terms of the highest
    degrees carry a large part of an output's variance.
    """
    if not isinstance(inputs, Mapping | None):
        raise refusal("galerkin: inputs", "signals by name, such as {'road': ...}", inputs)
    if integrator is not None:
        one_of("galerkin: integrator", integrator, AbstractIntegrator, "al.integrators.RungeKutta4()")
    expansion = one_of("galerkin: expansion", Expansion() if expansion is None else expansion, Expansion)
    model = _Model(system, dict(inputs or {}))
    _check(system, grid, model, integrator)
    places = placements(model)
    if isinstance(expansion.index_set, Adaptive):
        raise ProblemError("galerkin: an Adaptive index set needs samples; expected a fixed one, such as TotalDegree.")
    basis = Basis(places.germs, expansion.index_set.indices(places.germ_names, expansion.order))
    quadrature = quadrature_over(basis, expansion)
    decisions = jnp.asarray(places.vector("initial"))
    numbers, rest = eqx.partition(numbers_to_arrays((model, grid)), eqx.is_array)

    def projected(numbers: Pytree, quadrature: Quadrature) -> dict[str, Array]:
        model, grid = eqx.combine(numbers, rest)
        realised = eqx.filter_vmap(lambda point: realise(model, point, decisions))(quadrature.points)
        if isinstance(system, AlgebraicSystem):
            return projected_outputs(realised.system, quadrature)
        outputs = simulate(GalerkinSystem(system.states, realised, quadrature), grid, {}, integrator)
        return {name: jnp.moveaxis(values, 1, 0) for name, values in outputs.items()}

    use = Use.ONCE if isinstance(system, AlgebraicSystem) else Use.LOOPS
    coefficients = evaluate(projected, numbers, quadrature, use=use)
    distributions = {name: distribution.initial() for name, distribution in places.distributions.items()}
    expanded = Expanded(distributions, basis, coefficients, None, None, expansion.tolerance)
    if isinstance(grid, Grid):
        _refuse_diverged(expanded, np.asarray(grid.times))
    else:
        _refuse_unsolved(expanded, lambda point: realise(model, point, decisions).system, quadrature)
    _warn_unresolved(expanded)
    return expanded


def _check(
    system: System | AlgebraicSystem, grid: Grid | None, model: _Model, integrator: AbstractIntegrator | None
) -> None:
    if not isinstance(system, System | AlgebraicSystem):
        raise ProblemError(
            f"galerkin: expected a System or an AlgebraicSystem; received {type(system).__name__}. Use al.expand for "
            "functions."
        )
    if isinstance(system, AlgebraicSystem):
        given = {"grid": grid, "inputs": model.inputs or None, "integrator": integrator}
        if any(one is not None for one in given.values()):
            names = [name for name, one in given.items() if one is not None]
            raise ProblemError(
                f"galerkin: {type(system).__name__} is algebraic and has no time: expected neither grid, inputs nor "
                f"integrator, as in al.galerkin(system, expansion=al.Expansion(4)); received {' and '.join(names)}."
            )
    else:
        if not isinstance(grid, Grid):
            raise ProblemError(f"galerkin: expected a Grid; received {type(grid).__name__} {grid!r}.")
        check_inputs(system, model.inputs)
    if not placements(model).distributions:
        raise ProblemError(
            "galerkin: nothing in the system is uncertain; put a distribution, such as al.Uniform.bounds(0.9, 1.1), in "
            "the place of a number."
        )


def _refuse_diverged(expanded: Expanded, times: np.ndarray) -> None:
    """Refuse coefficients of histories that are not finite throughout."""
    for name, terms in expanded.coefficients.items():
        known = concrete(terms)
        if known is None:
            continue
        finite = np.isfinite(known).reshape(*known.shape[:2], -1).all(axis=(0, 2))
        if not finite.all():
            raise SimulationError(
                f"galerkin: output '{name}' is not finite from t = {times[np.argmin(finite)]:.4g} s on. Shorten the "
                "time step, lower the order or use an implicit integrator (al.integrators.Kvaerno5)."
            )


def _refuse_unsolved(expanded: Expanded, realised_at: Any, quadrature: Quadrature) -> None:
    """Refuse coefficients that are not finite because Newton's method found no solution."""
    known = {name: concrete(terms) for name, terms in expanded.coefficients.items()}
    bad = [name for name, terms in known.items() if terms is not None and not np.isfinite(terms).all()]
    if bad:
        why = unsolved_node(realised_at, quadrature.points)
        raise SimulationError(
            f"galerkin: no finite coefficients were found for {', '.join(bad)}. "
            + (
                why
                or "The equations have a solution at each node of the quadrature, but not once projected: guess "
                "closer to it, narrow the distributions, change the order, or use al.expand."
            )
        )


def _warn_unresolved(expanded: Expanded) -> None:
    """Warn if the highest degrees still matter."""
    shares = {name: concrete(share) for name, share in expanded.error.items()}
    limit = expanded.tolerance
    bad = {name: float(share) for name, share in shares.items() if share is not None and not share <= limit}
    if bad:
        listed = ", ".join(f"{name} ({share:.2g})" for name, share in bad.items())
        warnings.warn(
            f"galerkin: the highest degrees carry a large part of the variance of {listed}: errors above {limit:g} "
            "make means and spreads unreliable. Raise the order, shorten the time or narrow the distributions.",
            ExpansionWarning,
            stacklevel=3,
        )
