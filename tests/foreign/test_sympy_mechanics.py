"""Equations of motion of SymPy against our own bodies and joints, and closed forms."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sympy as sp
from sympy.physics import mechanics as me
from sympy.physics.mechanics.models import n_link_pendulum_on_cart
from sympy_models import (
    L_1,
    L_2,
    OMEGA,
    ROD,
    RODS,
    T_A,
    T_B,
    TAU,
    THETA,
    U_A,
    U_B,
    WORLD,
    A,
    B,
    D,
    G,
    L,
    M,
    Rods,
    chain,
    couples,
    frames,
    hinge,
    rod_by_kane,
    rod_by_lagrange,
    rod_on,
    rods_by_kane,
    rods_by_lagrange,
    weights,
)

import aleator as al
from aleator._core.code import read_code
from compiling import compiled

RODS_OF = {
    "Kane": lambda: al.foreign.from_kane(rods_by_kane(), RODS),
    "Lagrange": lambda: al.foreign.from_lagrange(rods_by_lagrange(), RODS),
}
ROD_OF = {
    "Kane": lambda: al.foreign.from_kane(rod_by_kane(), ROD),
    "Lagrange": lambda: al.foreign.from_lagrange(rod_by_lagrange(), ROD),
}


@compiled
def motions(model, q, v, force):
    """Accelerations at many states, and their derivatives by every number of the model at the first of them."""
    accelerations = jax.vmap(model.forward_dynamics)(q, v, force)
    return accelerations, jax.jacfwd(lambda one: one.forward_dynamics(q[0], v[0], force[0]))(model)


def traced(model):
    return jax.tree.map(lambda number: jnp.asarray(number, dtype=float), model)


def states(count, seed=3):
    generator = np.random.default_rng(seed)
    return [generator.normal(size=(count, 2)) * scale for scale in (2.0, 4.0, 5.0)]


@pytest.mark.parametrize("method", RODS_OF)
def test_accelerations_of_a_double_pendulum_and_their_derivatives_are_those_of_bodies_and_joints(method):
    at = states(50)
    (found, slopes), (expected, expected_slopes) = (
        motions(traced(model), *at) for model in (RODS_OF[method](), Rods())
    )
    assert np.abs(expected).max() > 10
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    for name in ("m_1", "m_2", "l_1", "l_2", "d", "g"):
        wanted = np.asarray(getattr(expected_slopes, name))
        scale = np.abs(wanted).max()
        np.testing.assert_allclose(slopes.numbers[name], wanted, rtol=1e-11, atol=1e-11 * scale, err_msg=name)
        assert scale > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("method", RODS_OF)
def test_a_simulation_of_a_double_pendulum_is_that_of_bodies_and_joints(method):
    grid, torque = al.Grid(1.0, 200), al.PowerSeries(start=(0.5, -1.0), end=(0.2, 2.0))
    ours = al.simulate(al.ForwardDynamics(Rods(), torque={"a_torque": torque}, start={"a": 0.4, "b": -0.9}), grid)
    model = RODS_OF[method]()
    system = al.ForwardDynamics(model, torque={"t_a": torque}, start={"a": 0.4, "b": -0.9})
    theirs = al.simulate(system, grid)
    assert np.ptp(ours["a"]) > 1
    for name in ("a", "b", "a_rate", "b_rate", "a_acceleration"):
        np.testing.assert_allclose(theirs[name], ours[name], rtol=0, atol=1e-12, err_msg=name)
    np.testing.assert_allclose(theirs["t_a"], ours["a_torque"], rtol=1e-14)


@pytest.mark.parametrize("method", ROD_OF)
def test_a_rod_on_a_damped_hinge_swings_as_its_equation_says(method):
    # m l²/3 θ̈ = τ - d ω - m g l/2 cos θ
    q, v, torque = np.array([0.3, -2.0]), np.array([-1.2, 3.0]), np.array([0.0, 1.7])
    found = compiled(jax.vmap(ROD_OF[method]().forward_dynamics))(q[:, None], v[:, None], torque[:, None])
    np.testing.assert_allclose(found[:, 0], 3 * (torque - 0.1 * v - 9.81 / 2 * np.cos(q)), rtol=1e-13)


@pytest.mark.slow
def test_speeds_that_are_no_rates_of_coordinates_describe_the_same_motion():
    # The second speed is the absolute rate of the second rod.
    method = me.KanesMethod(WORLD, [A, B], [U_A, U_B], kd_eqs=[A.diff() - U_A, A.diff() + B.diff() - U_B])
    pin, (inner, outer) = hinge(), frames()
    inner.set_ang_vel(WORLD, U_A * WORLD.z)
    outer.set_ang_vel(inner, (U_B - U_A) * WORLD.z)
    rods = chain(pin, inner, outer)
    method.kanes_equations(rods, [*weights(rods), *couples(inner, outer, U_A, U_B - U_A)])
    model = al.foreign.from_kane(method, RODS, outputs={"spin": B.diff(), "gained": U_B.diff() - U_A.diff()})
    assert not model.moves_directly
    grid, start = al.Grid(0.5, 100), {"a": 0.4, "b": -0.9}
    found = al.simulate(al.ForwardDynamics(model, start=start | {"u_a": 1.0, "u_b": 3.0}), grid)
    ours = al.simulate(al.ForwardDynamics(Rods(), start=start | {"a_rate": 1.0, "b_rate": 2.0}), grid)
    for theirs, name in (("a", "a"), ("spin", "b_rate"), ("gained", "b_acceleration"), ("a_acceleration",) * 2):
        np.testing.assert_allclose(found[theirs], ours[name], rtol=0, atol=1e-9, err_msg=name)


X, Y = me.dynamicsymbols("x y")


def ball():
    """A point mass, and its Lagrangian."""
    pin = hinge()
    place = pin.locatenew("P", X * WORLD.x + Y * WORLD.y)
    place.set_vel(WORLD, place.pos_from(pin).dt(WORLD))
    mass = me.Particle("ball", place, M)
    mass.potential_energy = M * G * Y
    return me.Lagrangian(WORLD, mass)


def test_holonomic_constraints_hold_exactly_and_multipliers_are_those_of_sympy():
    method = me.LagrangesMethod(ball(), [X, Y], hol_coneqs=[X**2 + Y**2 - L**2])
    method.form_lagranges_equations()
    model = al.foreign.from_lagrange(method, {M: 2.0, L: 0.5, G: 9.81}, outputs={"tension": -2 * L * method.lam_vec[0]})
    system = al.ForwardDynamics(model, start={"x": 0.3}, guess={"y": -0.4})
    found = al.simulate(system, al.Grid(1.0, 400))
    assert np.ptp(found["x"]) > 0.5
    np.testing.assert_allclose(found["x"] ** 2 + found["y"] ** 2, 0.25, rtol=1e-12)
    # It starts at rest, 0.1 m above the lowest place: v² = 2 g (y(0) - y), and m v² / l + m g cos(angle) holds it.
    y = found["y"]
    np.testing.assert_allclose(found["tension"], 2 * (2 * 9.81 * (-0.4 - y)) / 0.5 - 2 * 9.81 * y / 0.5, rtol=1e-6)


@pytest.mark.slow
def test_dependent_speeds_are_simulated_by_the_whole_mass_matrix():
    u, w = me.dynamicsymbols("u w")
    pin = hinge()
    place = pin.locatenew("P", X * WORLD.x + Y * WORLD.y)
    place.set_vel(WORLD, u * WORLD.x + w * WORLD.y)
    kane = me.KanesMethod(
        WORLD,
        [X],
        [u],
        kd_eqs=[X.diff() - u, Y.diff() - w],
        q_dependent=[Y],
        u_dependent=[w],
        configuration_constraints=[X**2 + Y**2 - L**2],
        velocity_constraints=[X * u + Y * w],
    )
    kane.kanes_equations([me.Particle("ball", place, M)], [(place, -M * G * WORLD.y)])
    with pytest.raises(al.ProblemError, match=r"dependent ones: \[y\(t\), w\(t\)\]\. Use LagrangesMethod"):
        al.foreign.from_kane(kane, {M: 2.0, L: 0.5, G: 9.81})
    rates = dict(zip([*kane.q, *kane.u], kane.forcing_full, strict=True))
    swing = al.foreign.from_sympy(rates, {M: 2.0, G: 9.81}, mass_matrix=kane.mass_matrix_full, start={X: 0.3, Y: -0.4})
    found = al.simulate(swing, al.Grid(0.5, 400))
    energy = (found["u"] ** 2 + found["w"] ** 2) / 2 + 9.81 * found["y"]
    assert np.ptp(found["x"]) > 0.3
    np.testing.assert_allclose(found["x"] ** 2 + found["y"] ** 2, 0.25, rtol=1e-8)
    np.testing.assert_allclose(energy, -0.4 * 9.81, rtol=1e-8)


def test_inverse_dynamics_of_a_model_with_a_wind_that_changes_gives_the_torque():
    wind = me.dynamicsymbols("wind")
    pin, frame = hinge(), WORLD.orientnew("A", "Axis", [THETA, WORLD.z])
    frame.set_ang_vel(WORLD, OMEGA * WORLD.z)
    rod, _ = rod_on("rod", frame, pin, M, L)
    kane = me.KanesMethod(WORLD, [THETA], [OMEGA], kd_eqs=[THETA.diff() - OMEGA])
    kane.kanes_equations([rod], [*weights([rod]), (frame, (TAU + wind**2) * WORLD.z)])
    numbers = {one: value for one, value in ROD.items() if one != D}
    with pytest.raises(al.ProblemError, match=r"received wind\(t\), which does not\. Give it in numbers"):
        al.foreign.from_kane(kane, numbers)
    blows = al.PowerSeries(start=(1.0, 0.0), end=(3.0, 0.0))
    model = al.foreign.from_kane(kane, numbers | {wind: blows}, outputs={"pressure": wind**2})
    motion = al.PowerSeries(start=(0.0, 0.0), end=(1.0, 0.0))
    found = al.simulate(al.InverseDynamics(model, motion={"theta": motion}), al.Grid(2.0, 20))
    needed = found["theta_acceleration"] / 3 + 9.81 / 2 * np.cos(found["theta"])
    np.testing.assert_allclose(found["tau"], needed - found["pressure"], rtol=1e-12)
    assert np.asarray(found["pressure"])[[0, -1]] == pytest.approx([1.0, 9.0])


@pytest.mark.slow
def test_second_derivatives_by_numbers_are_those_of_sympy():
    kane, plain = rods_by_kane(), dict(zip((A, B, U_A, U_B), sp.symbols("a b u v"), strict=True))
    forcing = kane.forcing[0].subs({T_A: 0, T_B: 0}).xreplace(plain)
    at = dict(zip(plain.values(), (0.4, -0.9, 1.1, -2.0), strict=True)) | RODS
    expected = -float(forcing.diff(L_1, L_2).subs(at)), -float(forcing.diff(L_1, plain[B]).subs(at))

    def bias(numbers):
        model = eqx.tree_at(
            lambda one: (one.numbers["l_1"], one.numbers["l_2"]), traced(RODS_OF["Kane"]()), numbers[:2]
        )
        return model.bias(jnp.stack([jnp.asarray(0.4), numbers[2]]), jnp.array([1.1, -2.0]))[0]

    hessian = jax.hessian(bias)(jnp.array([0.9, 0.6, -0.9]))
    np.testing.assert_allclose(hessian[0, 1:], expected, rtol=1e-12)


def test_a_cart_with_three_links_accelerates_as_the_equations_of_sympy_say():
    kane = n_link_pendulum_on_cart(3, cart_force=True, joint_torques=True)
    symbols = kane.mass_matrix.free_symbols | kane.forcing.free_symbols
    numbers = {one: 0.7 + 0.1 * i for i, one in enumerate(sorted(symbols - {me.dynamicsymbols._t}, key=str))}
    model = al.foreign.from_kane(kane, numbers)
    assert model.coordinates == ("q0", "q1", "q2", "q3")
    assert model.actuators == ("F", "T1", "T2", "T3")
    q, v, torque = np.random.default_rng(5).normal(size=(3, 4))
    found = compiled(lambda q, v, torque: model.forward_dynamics(q, v, model.actuation(q) @ torque))(q, v, torque)
    torques = me.dynamicsymbols("F T1 T2 T3")
    at = dict(zip([*kane.q, *kane.u, *torques], [*q, *v, *torque], strict=True)) | numbers
    mass, forcing = (np.array(one.xreplace(at), dtype=float) for one in (kane.mass_matrix, kane.forcing))
    np.testing.assert_allclose(found, np.linalg.solve(mass, forcing).ravel(), rtol=1e-11)


def test_models_made_again_are_of_one_structure_and_others_are_not():
    def structure(method):
        return jax.tree.structure(al.foreign.from_kane(method, ROD))

    # Two separate derivations of the same equations.
    again = rod_by_kane.__wrapped__()
    assert structure(again) == structure(rod_by_kane())
    assert jax.tree.structure(al.foreign.from_kane(again, ROD | {M: 2.0})) == structure(again)
    heavier = al.foreign.from_kane(again, ROD, outputs={"height": L * sp.sin(THETA)})
    assert jax.tree.structure(heavier) != structure(again)
    assert not read_code(heavier).doubts
