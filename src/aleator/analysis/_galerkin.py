"""Intrusive Galerkin projection (equation 22): the coefficients of all states are integrated together."""

import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import Pytree, numbers_to_arrays
from aleator._core.errors import ExpansionWarning, ProblemError, SimulationError
from aleator._core.given import one_of, refusal
from aleator._core.leaves import transparent
from aleator._core.tracing import trace
from aleator.analysis._expanded import Expanded
from aleator.analysis._inputs import concrete
from aleator.collocation import Adaptive, Basis, Expansion, GaussPoints, SmolyakPoints
from aleator.dynamics import AbstractIntegrator, Grid, System, simulate
from aleator.dynamics._system import check_inputs, derivative, initial_state, observation
from aleator.trajectories import AbstractSignal
from aleator.uncertainty import realise, survey

# Beyond this many quadrature nodes in each evaluation of the right-hand side, collocation is the better method by far.
_MOST_NODES = 20_000


class _Quadrature(NamedTuple):
    """Nodes of a quadrature over the germ, the polynomials there, and the projection onto them."""

    points: Float[Array, "nodes variables"]
    matrix: Float[Array, "nodes terms"]
    projection: Float[Array, "terms nodes"]


@transparent("system")
class _Model(NamedTuple):
    """What may hold distributions."""

    system: System
    inputs: dict[str, AbstractSignal]


@final
class GalerkinSystem(System):
    """A system whose states are the coefficients of another's, of shape (terms, *shape) each.

    - `realised`: system and inputs at each quadrature node, with a leading axis for the nodes;
    - `quadrature`: projects what they do there onto the polynomials.
    """

    states: tuple[str, ...] = eqx.field(static=True)  # type: ignore[assignment, misc]
    realised: Pytree
    quadrature: _Quadrature

    def rhs(self, t: Any, z: Any) -> tuple[Array, ...]:
        """The rates of the coefficients: `<Psi_n, f(sum_j x_j Psi_j, theta)>`, equation (22)."""
        return tuple(self._projected(derivative, t, z))

    def outputs(self, t: Any, z: Any) -> dict[str, Array]:
        """The coefficients of the outputs."""
        return self._projected(observation, t, z)

    def initial(self) -> dict[str, Array]:
        """The coefficients of the initial state."""
        states = eqx.filter_vmap(lambda model: initial_state(model.system))(self.realised)
        return jax.tree.map(self._project, states)._asdict()

    def _projected(self, function: Any, t: Any, z: Any) -> Any:
        """The coefficients of `function(system, t, z, inputs)`."""

        def at_node(model: _Model, state: Any) -> Any:
            return function(model.system, t, state, {name: signal(t) for name, signal in model.inputs.items()})

        states = jax.tree.map(lambda terms: jnp.tensordot(self.quadrature.matrix, terms, axes=1), z)
        return jax.tree.map(self._project, eqx.filter_vmap(at_node)(self.realised, states))

    def _project(self, values: Float[Array, "nodes *shape"]) -> Float[Array, "terms *shape"]:
        return jnp.tensordot(self.quadrature.projection, values, axes=1)


def galerkin(
    system: System,
    grid: Grid,
    expansion: Expansion | None = None,
    inputs: Mapping[str, AbstractSignal] | None = None,
    integrator: AbstractIntegrator | None = None,
) -> Expanded:
    """Expand the histories of all outputs of an uncertain system by intrusive Galerkin projection, equation (22).

    The coefficients of all states are integrated as one large system, whose right-hand side is projected by quadrature
    at each evaluation. It converges to what `expand` gives for the simulation, which is cheaper where there are many
    variables: a second opinion that shares neither points nor fit.

    `expansion` gives order and index set, and the quadrature if its points are `GaussPoints` or `SmolyakPoints`; the
    default is a full Gauss grid that integrates products of three polynomials of the basis.

    Raises `ProblemError` if nothing is uncertain or the quadrature is too large, `SimulationError` if the coefficients
    do not stay finite. Warns with `ExpansionWarning` if the terms of the highest degrees carry a large part of an
    output's variance.
    """
    if not isinstance(inputs, Mapping | None):
        raise refusal("galerkin: inputs", "signals by name, such as {'road': ...}", inputs)
    if integrator is not None:
        one_of("galerkin: integrator", integrator, AbstractIntegrator, "al.RungeKutta4()")
    expansion = one_of("galerkin: expansion", Expansion() if expansion is None else expansion, Expansion)
    model = _Model(system, dict(inputs or {}))
    _check(system, grid, model)
    places = survey(model)
    if isinstance(expansion.index_set, Adaptive):
        raise ProblemError("galerkin: an Adaptive index set needs samples; expected a fixed one, such as TotalDegree.")
    basis = Basis(places.germs, expansion.index_set.indices(places.germ_names, expansion.order))
    quadrature = _quadrature(basis, expansion)
    decisions = jnp.asarray(places.vector("initial"))
    numbers, rest = eqx.partition(numbers_to_arrays((model, grid)), eqx.is_array)

    def histories(numbers: Pytree, quadrature: _Quadrature) -> dict[str, Array]:
        model, grid = eqx.combine(numbers, rest)
        realised = eqx.filter_vmap(lambda point: realise(model, point, decisions))(quadrature.points)
        expanded = GalerkinSystem(system.states, realised, quadrature)
        outputs = simulate(expanded, grid, {}, integrator)
        return {name: jnp.moveaxis(values, 1, 0) for name, values in outputs.items()}

    coefficients = trace(histories, numbers, quadrature, code=(model, integrator), name=type(system).__name__)(
        numbers, quadrature
    )
    laws = {name: law.initial() for name, law in places.distributions.items()}
    expanded = Expanded(laws, basis, coefficients, None, None, expansion.tolerance)
    _judge(expanded, np.asarray(grid.times))
    return expanded


def _check(system: System, grid: Grid, model: _Model) -> None:
    if not isinstance(system, System):
        raise ProblemError(
            f"galerkin: expected a System; received {type(system).__name__}. Use al.expand for functions."
        )
    if not isinstance(grid, Grid):
        raise ProblemError(f"galerkin: expected a Grid; received {type(grid).__name__} {grid!r}.")
    check_inputs(system, model.inputs)
    if not survey(model).distributions:
        raise ProblemError(
            "galerkin: nothing in the system is uncertain; put a distribution, such as al.Uniform.bounds(0.9, 1.1), in "
            "the place of a number."
        )


def _quadrature(basis: Basis, expansion: Expansion) -> _Quadrature:
    """The quadrature that the expansion names, if it names one; else one exact for products of three polynomials."""
    named = isinstance(expansion.points, GaussPoints | SmolyakPoints)
    points = expansion.points if named else GaussPoints(3 * max(basis.degrees) // 2 + 2)
    nodes = points.nodes(basis, 0)
    if len(nodes.points) > _MOST_NODES:
        raise ProblemError(
            f"galerkin: the quadrature over {basis.variables} variables has {len(nodes.points)} nodes, at each of "
            f"which every evaluation needs the right-hand side (limit {_MOST_NODES}). Lower the order, name "
            "points=al.SmolyakPoints(), or use al.expand."
        )
    matrix = basis.matrix(nodes.points)
    return _Quadrature(*map(jnp.asarray, (nodes.points, matrix, matrix.T * nodes.weights[None])))


def _judge(expanded: Expanded, times: np.ndarray) -> None:
    """Refuse coefficients that are not finite, and warn where the highest degrees still matter."""
    for name, terms in expanded.coefficients.items():
        known = concrete(terms)
        if known is None:
            continue
        finite = np.isfinite(known).reshape(*known.shape[:2], -1).all(axis=(0, 2))
        if not finite.all():
            raise SimulationError(
                f"galerkin: output '{name}' is not finite from t = {times[np.argmin(finite)]:.4g} s on. Shorten the "
                "time step, lower the order or use an implicit integrator (al.Kvaerno5)."
            )
    shares = {name: concrete(share) for name, share in expanded.error.items()}
    limit = expanded.tolerance
    bad = {name: float(share) for name, share in shares.items() if share is not None and not share <= limit}
    if bad:
        listed = ", ".join(f"{name} ({share:.2g})" for name, share in bad.items())
        warnings.warn(
            f"galerkin: the highest degrees carry a large part of the variance of {listed}: errors above {limit:g} "
            "make means and spreads unreliable. Raise the order or shorten the time.",
            ExpansionWarning,
            stacklevel=3,
        )
