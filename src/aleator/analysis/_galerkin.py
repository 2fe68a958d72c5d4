"""Intrusive Galerkin projection (equations 20 to 22): all coefficients are integrated or solved for together."""

import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Pytree, jax_array, numbers_to_arrays
from aleator._core.border import one_of, refusal
from aleator._core.compilation import Use, evaluate
from aleator._core.errors import ExpansionWarning, ProblemError, SimulationError
from aleator._core.leaves import transparent
from aleator.analysis._expanded import Expanded
from aleator.dynamics import (
    AbstractIntegrator,
    AlgebraicSystem,
    Grid,
    System,
    check_inputs,
    derivative,
    explain_failure,
    initial_state,
    observation,
    simulate,
    solve_algebraic,
)
from aleator.dynamics._algebraic import equations, first_guess, outputs_at
from aleator.dynamics._newton import constant_terms, newton
from aleator.ensemble import concrete, is_finite
from aleator.expansion import Adaptive, Basis, Expansion, GaussPoints, SmolyakPoints
from aleator.trajectories import AbstractSignal
from aleator.uncertainty import placements, realise, refuse_intervals

# Beyond this many quadrature nodes per evaluation of the equations, collocation is far better.
_MOST_NODES = 20_000


class Quadrature(NamedTuple):
    """Nodes of a quadrature over the germ, the polynomials there, and the projection onto them."""

    points: Float[Array, "nodes variables"]
    matrix: Float[Array, "nodes terms"]
    projection: Float[Array, "terms nodes"]

    def at_nodes(self, coefficients: Float[Array, "terms *shape"]) -> Float[Array, "nodes *shape"]:
        """An expansion at the nodes."""
        return jnp.tensordot(self.matrix, coefficients, axes=1)

    def project(self, values: Float[Array, "nodes *shape"]) -> Float[Array, "terms *shape"]:
        """The coefficients `<Psi_n, values>`."""
        return jnp.tensordot(self.projection, values, axes=1)


def quadrature_over(basis: Basis, expansion: Expansion) -> Quadrature:
    """The quadrature of the expansion's points, if they have one; else one exact for products of three polynomials."""
    named = isinstance(expansion.points, GaussPoints | SmolyakPoints)
    points = expansion.points if named else GaussPoints(3 * max(basis.degrees) // 2 + 2)
    nodes = points.nodes(basis, 0)
    if len(nodes.points) > _MOST_NODES:
        raise ProblemError(
            f"galerkin: the quadrature over {basis.variables} variables has {len(nodes.points)} nodes, at each of "
            f"which every evaluation needs the equations (limit {_MOST_NODES}). Lower the order, name "
            "points=al.points.SmolyakPoints(), or use al.expand."
        )
    matrix = basis.matrix(nodes.points)
    return Quadrature(*map(jax_array, (nodes.points, matrix, matrix.T * nodes.weights[None])))


def projected_outputs(realised: AlgebraicSystem, quadrature: Quadrature) -> dict[str, Float[Array, "terms *shape"]]:
    """The coefficients of the outputs; NaN if Newton's method finds no coefficients of the unknowns.

    The unknowns' coefficients solve `<Psi_n, A(sum_j rho_j Psi_j, theta)> = 0` for every term `n` and every equation
    `A`: equation (20), projected as (22) is, with `j, n = 0..n_b-1`. `realised` is the system at each quadrature node,
    with a leading axis for the nodes. Numbers affine in the germ, equations (13) and (14), are there as (20) expands
    them; others are not truncated. Newton's method starts from the coefficients of the guess.
    """
    guesses = eqx.filter_vmap(first_guess)(realised)
    guess = jax.tree.map(quadrature.project, guesses)
    start, named = ravel_pytree(guess)
    if not start.size:
        return _projected_at(realised, quadrature, guess)
    at_node = sum(values[0].size for values in guesses)

    def left(vector: Float[Array, " n"]) -> Float[Array, " n"]:
        values = _at_nodes(lambda system, rho: equations(system, rho, at_node), realised, quadrature, named(vector))
        return jnp.ravel(quadrature.project(values))

    def terms_of(system: AlgebraicSystem, rho: Any) -> Float[Array, " equations"]:
        return constant_terms(lambda numbers: equations(numbers, rho, at_node), system)

    sizes = eqx.filter_vmap(terms_of)(realised, guesses)
    root = newton(left, start, jnp.ravel(jnp.abs(quadrature.projection) @ sizes), _numbers_expanded(guess))
    outputs = _projected_at(realised, quadrature, named(root.point))
    return {name: jnp.where(root.converged, terms, jnp.nan) for name, terms in outputs.items()}


def unsolved_node(realised_at: Callable[[Array], AlgebraicSystem], points: Float[Array, "nodes variables"]) -> str:
    """Why the equations have no solution at some quadrature node; empty if they have one at every node."""
    converged = eqx.filter_vmap(lambda point: solve_algebraic(realised_at(point)).converged)(points)
    return "" if np.all(converged) else explain_failure(realised_at(points[int(np.argmin(converged))]))


def _at_nodes(function: Callable[..., Any], realised: AlgebraicSystem, quadrature: Quadrature, rho: Any) -> Any:
    """`function(system, unknowns)` at each node, where the unknowns have the coefficients `rho`."""
    return eqx.filter_vmap(function)(realised, jax.tree.map(quadrature.at_nodes, rho))


def _projected_at(realised: AlgebraicSystem, quadrature: Quadrature, rho: Any) -> dict[str, Array]:
    return jax.tree.map(quadrature.project, _at_nodes(outputs_at, realised, quadrature, rho))


def _numbers_expanded(rho: Any) -> np.ndarray:
    """The number, counted over all unknowns, to which each coefficient belongs, and whose unit it shares."""
    counts = [values[0].size for values in rho]
    first = np.cumsum([0, *counts])
    return np.concatenate(
        [
            np.tile(first[i] + np.arange(count), len(values))
            for i, (count, values) in enumerate(zip(counts, rho, strict=True))
        ]
    )


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
    refuse_intervals("galerkin", places, "Take al.expand.")
    if isinstance(expansion.index_set, Adaptive):
        raise ProblemError("galerkin: an Adaptive index set needs samples; expected a fixed one, such as TotalDegree.")
    basis = Basis(places.germs, expansion.index_set.indices(places.germ_names, expansion.order))
    quadrature = quadrature_over(basis, expansion)
    decisions = jax_array(places.vector("initial"))
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
    expanded = Expanded(distributions, basis, coefficients, None, None, tolerance=expansion.tolerance)
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
        arguments = {"grid": grid, "inputs": model.inputs or None, "integrator": integrator}
        names = [name for name, argument in arguments.items() if argument is not None]
        if names:
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
                "time step, lower the order or use an implicit integrator (al.integrators.Rodas5P)."
            )


def _refuse_unsolved(expanded: Expanded, realised_at: Any, quadrature: Quadrature) -> None:
    """Refuse coefficients that are not finite because Newton's method found no solution."""
    bad = [name for name, terms in expanded.coefficients.items() if not is_finite(terms)]
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
