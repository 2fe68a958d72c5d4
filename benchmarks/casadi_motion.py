"""Two motion-planning problems under uncertainty, written by hand in CasADi and solved by IPOPT.

    python benchmarks/casadi_motion.py

The peer and the oracle of `motion.py`: nothing here comes from this library. It is what a careful engineer writes.
Everything between an instant's joint motion and its constraints is one scalar expression graph (SX), with all
collocation points in it and all that they share computed once; CasADi differentiates it, twice; the instants are a
`Function.map`. The splines are linear, so the sparse Jacobian and Hessian of the whole problem are constant matrices
times the entries of the instants' ones (`assembled`). `assembled=False` leaves that to CasADi, which colours and
differentiates the mapped problem as a whole: the same numbers, and up to four times slower.

Either Hessian goes with IPOPT's adaptive barrier; which one is faster depends on the problem.
"""

import csv
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import casadi as ca
import numpy as np
import scipy.sparse as sp
from numpy.polynomial import legendre
from scipy.interpolate import BSpline

GUARD = 1e-12  # added to a variance or a squared distance under a square root
COMPILED = {"jit": True, "compiler": "shell", "jit_options": {"flags": ["-O1"]}}
CONTROL_POINTS, DEGREE, HELD = 12, 3, 2  # of a joint's spline; `HELD` points at each end are fixed: rest to rest

# Planar two-link arm (5.5.2).
PLANAR_START, PLANAR_GOAL = np.full(2, np.pi / 6), np.full(2, -np.pi / 6)
PLANAR_TORQUE, PLANAR_INSTANTS = 10.0, 91
DISC_CENTRE, DISC_RADIUS = (0.65, 0.80), 0.30
PAYLOAD_MEAN, PAYLOAD_DEVIATION = 1.0, 0.5

# Six-axis arm.
ARM_DATA = Path(__file__).parents[1] / "tests/ur5e.csv"
ARM_START = np.deg2rad([-60.0, -60.0, 100.0, -130.0, -90.0, 0.0])  # the tool points down at both ends
ARM_GOAL = np.deg2rad([60.0, -75.0, 90.0, -105.0, -90.0, 90.0])
ARM_INSTANTS = 64  # 63 intervals, seven in each of the nine knot spans
GRAVITY = 9.81
TORQUE_SHARE = 0.36  # of the catalogue's torques: little more than holds the heaviest payload at the start
PAYLOAD_MASS = (2.0, 0.8)  # mean and half-width, kg, uniform; a point
PAYLOAD_OFFSET = (0.05, 0.03)  # mean and half-width, m, uniform; from the last frame's origin (the flange) along its z
TOOL_OFFSET, TOOL_RADIUS, TOOL_FLOOR = 0.05, 0.10, 0.10  # sphere about the tool point; the point's least height
FOREARM = ((0.0, 0.0, 0.0265), (-0.3922, 0.0, 0.0265))  # its capsule's axis in the third link's frame, and radius
FOREARM_RADIUS = 0.06
PILLAR = ((-0.60, 0.0, 0.0), (-0.60, 0.0, 0.50))  # its capsule's axis in the base frame, and radius
PILLAR_RADIUS = 0.06


@dataclass(frozen=True)
class Plan:
    """What a solution cost and gave; times in seconds, `evaluations` by IPOPT's own counters."""

    optimum: float
    control_points: np.ndarray  # (12, joints), those of the ends among them
    construction: float
    solution: float
    iterations: int
    evaluations: dict[str, int]
    status: str


def uniform_germ(count: int, variables: int) -> np.ndarray:
    """Hammersley points in [-1, 1]: `(i - 1/2)/count` beside the radical inverse of `i` in base 2, `i = 1 .. count`."""
    index = np.arange(1, count + 1)
    inverse = [sum(int(bit) / 2 ** (k + 1) for k, bit in enumerate(reversed(f"{i:b}"))) for i in index]
    return 2 * np.column_stack([(index - 0.5) / count, inverse])[:, :variables] - 1


def least_squares(germ: np.ndarray, order: int) -> np.ndarray:
    """The matrix (terms, points) from samples to coefficients of normalised Legendre products, the mean first."""
    variables = germ.shape[1]
    indices = sorted((i for i in product(range(order + 1), repeat=variables) if sum(i) <= order), key=sum)
    single = np.stack([np.sqrt(2 * n + 1) * legendre.legval(germ, np.eye(order + 1)[n]) for n in range(order + 1)])
    matrix = np.stack([np.prod([single[i[k], :, k] for k in range(variables)], axis=0) for i in indices], axis=1)
    return np.linalg.pinv(matrix)


def spline(instants: int) -> list[np.ndarray]:
    """Values and first two derivatives of the clamped uniform B-splines on [0, 1]: three times (instants, points)."""
    inner = np.linspace(0, 1, CONTROL_POINTS - DEGREE + 1)
    knots = np.concatenate([np.zeros(DEGREE), inner, np.ones(DEGREE)])
    basis = BSpline(knots, np.eye(CONTROL_POINTS), DEGREE)
    return [basis.derivative(n)(np.linspace(0, 1, instants)) for n in range(3)]


def spread_rows(samples: ca.SX, fit: np.ndarray, sigmas: float) -> ca.SX:
    """`mean + sigmas*std` above `mean - sigmas*std` of each row of `samples` (outputs, points)."""
    coefficients = samples @ ca.DM(fit.T)
    mean = coefficients[:, 0]
    deviation = ca.sqrt(ca.sum2(coefficients[:, 1:] ** 2) + GUARD)
    return ca.vertcat(mean + sigmas * deviation, mean - sigmas * deviation)


def solve(
    rows: Callable[[ca.SX, ca.SX, ca.SX], tuple[ca.SX, np.ndarray, np.ndarray]],
    ends: tuple[np.ndarray, np.ndarray],
    instants: int,
    *,
    guess: tuple[np.ndarray, float],
    box: np.ndarray | None = None,
    limited_memory: bool = False,
    assembled: bool = True,
    compiled: bool = False,
    options: dict | None = None,
) -> Plan:
    """Minimise the duration of a rest-to-rest spline motion.

    `rows(q, velocity, acceleration)` gives an instant's constraints and their bounds; `guess` the free control points
    (8, joints) and a duration; `box` bounds the control points of each joint, symmetrically. `options` are `nlpsol`'s.
    `compiled` has gcc translate an instant's functions first: evaluations three to four times
    faster, after a minute or two for the six-axis arm.
    """
    started = time.perf_counter()
    joints = len(ends[0])
    free = CONTROL_POINTS - 2 * HELD
    size = free * joints + 1

    # An instant: z = (q, dq/ds, d2q/ds2, duration), with s = t/duration.
    z = ca.SX.sym("z", 3 * joints + 1)
    q, dq, ddq = (z[n * joints : (n + 1) * joints] for n in range(3))
    g, lower, upper = rows(q, dq / z[-1], ddq / z[-1] ** 2)

    # z of all instants, linear in the decisions x (joint by joint, then the duration): z = chain x + offset.
    held = np.repeat(np.stack(ends), HELD, axis=0)  # the points 0, 1 and 10, 11
    chains, offsets = [], []
    for values in zip(*spline(instants), strict=True):
        weights = np.stack(values)  # (3, points)
        inner = weights[:, HELD:-HELD]
        fixed = np.concatenate([weights[:, :HELD], weights[:, -HELD:]], axis=1) @ held
        chain = np.einsum("kf,ij->kijf", inner, np.eye(joints)).reshape(3 * joints, size - 1)
        chains.append(np.block([[chain, np.zeros((3 * joints, 1))], [np.zeros((1, size - 1)), np.ones((1, 1))]]))
        offsets.append(np.append(fixed.reshape(-1), 0.0))
    x = ca.MX.sym("x", size)
    chain, offset = ca.DM(sp.csc_matrix(np.concatenate(chains))), ca.DM(np.concatenate(offsets))
    motion = ca.reshape(chain @ x + offset, z.numel(), instants)

    instant = ca.Function("instant", [z], [g], COMPILED if compiled else {})
    nlp = {"x": x, "f": x[-1], "g": ca.vec(instant.map(instants)(motion))}
    settings = {
        "print_time": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": 1000,
        "ipopt.hessian_approximation": "limited-memory" if limited_memory else "exact",
        "ipopt.mu_strategy": "adaptive",
        **(options or {}),
    }
    if assembled:
        settings |= _derivatives(instant, z, g, chains, chain, offset, size, limited_memory, compiled)
    solver = ca.nlpsol("solver", "ipopt", nlp, settings)
    bound = np.full(joints, np.inf) if box is None else box
    construction = time.perf_counter() - started

    started = time.perf_counter()
    solution = solver(
        x0=np.append(guess[0].T.reshape(-1), guess[1]),
        lbx=np.append(-np.repeat(bound, free), 0.1),
        ubx=np.append(np.repeat(bound, free), 20.0),
        lbg=np.tile(lower, instants),
        ubg=np.tile(upper, instants),
    )
    seconds = time.perf_counter() - started
    found = np.asarray(solution["x"]).reshape(-1)
    stats = solver.stats()
    return Plan(
        optimum=float(found[-1]),
        control_points=np.concatenate([held[:HELD], found[:-1].reshape(joints, free).T, held[HELD:]]),
        construction=construction,
        solution=seconds,
        iterations=stats["iter_count"],
        evaluations={k.removeprefix("n_call_nlp_"): n for k, n in stats.items() if k.startswith("n_call_nlp_") and n},
        status=stats["return_status"],
    )


def _derivatives(instant, z, g, chains, chain, offset, size, limited_memory, compiled) -> dict:
    """IPOPT's `jac_g` and `hess_lag` from those of an instant, by constant sparse matrices.

    J = J_k C_k and H = sum of C_k' H_k C_k, for instants k: linear in the entries of J_k and H_k.
    """
    instants, count, width = len(chains), g.numel(), z.numel()
    x, p = ca.MX.sym("x", size), ca.MX.sym("p", 0)
    motion = ca.reshape(chain @ x + offset, width, instants)

    local = ca.jacobian(g, z)
    entries = ca.Function("jacobian", [z], [local.nz[:]], COMPILED if compiled else {})
    r, c = (np.asarray(a) for a in local.sparsity().get_triplet())
    pattern = sp.csc_matrix((np.ones(len(r)), (r, c)), shape=(count, width))
    blocks = [pattern @ (np.abs(C) > 0) for C in chains]
    whole = sp.csc_matrix(sp.vstack([sp.csc_matrix(b) for b in blocks]))
    sparsity = _sparsity(whole)
    where = _positions(whole)
    spread = []
    for k, C in enumerate(chains):
        for n, (i, j) in enumerate(zip(r, c, strict=True)):
            spread += [(where[k * count + i, b], k * len(r) + n, C[j, b]) for b in np.flatnonzero(C[j])]
    jacobian = ca.MX(sparsity, _matrix(spread, (whole.nnz, instants * len(r))) @ ca.vec(entries.map(instants)(motion)))
    given = ca.Function(
        "jac_g", [x, p], [ca.vec(instant.map(instants)(motion)), jacobian], ["x", "p"], ["g", "jac_g_x"]
    )
    if limited_memory:
        return {"jac_g": given}

    multipliers = ca.SX.sym("multipliers", count)
    local = ca.triu(ca.hessian(ca.dot(multipliers, g), z)[0])
    entries = ca.Function("hessian", [z, multipliers], [local.nz[:]], COMPILED if compiled else {})
    r, c = (np.asarray(a) for a in local.sparsity().get_triplet())
    spread, keys = [], {}
    for k, C in enumerate(chains):
        for n, (i, j) in enumerate(zip(r, c, strict=True)):
            for a, b in product(np.flatnonzero(C[i]), np.flatnonzero(C[j])):
                # An off-diagonal entry of H_k stands for its mirror image too.
                if i == j and a > b:
                    continue
                both = 2.0 if (i != j and a == b) else 1.0
                spread.append(((min(a, b), max(a, b)), k * len(r) + n, both * C[i, a] * C[j, b]))
                keys[min(a, b), max(a, b)] = 1.0
    ordered = np.array(sorted(keys))
    whole = sp.csc_matrix((np.ones(len(ordered)), (ordered[:, 0], ordered[:, 1])), shape=(size, size))
    where = _positions(whole)
    scatter = _matrix([(where[key], column, v) for key, column, v in spread], (whole.nnz, instants * len(r)))
    weight, dual = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", instants * count)
    mapped = entries.map(instants)(motion, ca.reshape(dual, count, instants))
    hessian = ca.MX(_sparsity(whole), scatter @ ca.vec(mapped))
    names = ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
    return {"jac_g": given, "hess_lag": ca.Function("hess_lag", [x, p, weight, dual], [hessian], *names)}


def _sparsity(matrix: sp.csc_matrix) -> ca.Sparsity:
    matrix.sort_indices()
    return ca.Sparsity(*matrix.shape, matrix.indptr.tolist(), matrix.indices.tolist())


def _positions(matrix: sp.csc_matrix) -> dict[tuple[int, int], int]:
    columns = np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))
    return {(int(i), int(j)): n for n, (i, j) in enumerate(zip(matrix.indices, columns, strict=True))}


def _matrix(entries: list[tuple[int, int, float]], shape: tuple[int, int]) -> ca.DM:
    rows, columns, values = zip(*entries, strict=True)
    return ca.DM(sp.csc_matrix((values, (rows, columns)), shape=shape))


# --- the planar arm ---------------------------------------------------------------------------------------------------


def planar_torque(q: ca.SX, v: ca.SX, a: ca.SX, payload: float) -> ca.SX:
    """Joint torques of two uniform rods of mass 1 and length 1 in the horizontal plane with a point at the tip."""
    outer = 1 / 3 + payload  # inertia of the second link about its joint
    coupling = (0.5 + payload) * ca.cos(q[1])
    bend = (0.5 + payload) * ca.sin(q[1])
    inner = 1 / 3 + 1 + payload
    first = (inner + outer + 2 * coupling) * a[0] + (outer + coupling) * a[1] - bend * (2 * v[0] + v[1]) * v[1]
    return ca.vertcat(first, (outer + coupling) * a[0] + outer * a[1] + bend * v[0] ** 2)


def segment_to_point(start: ca.SX, end: ca.SX, point: ca.DM) -> ca.SX:
    """Distance between a segment and a point."""
    along = end - start
    share = ca.fmax(0, ca.fmin(1, ca.dot(point - start, along) / ca.dot(along, along)))
    return ca.sqrt(ca.sumsqr(start + share * along - point) + GUARD)


def pick_and_place_time(
    sigmas: float,
    deterministic: bool = False,
    points: int = 18,
    order: int = 5,
    *,
    duration: float = 2.0,
    perturbation: float = 0.0,
    seed: int = 0,
    limited_memory: bool = False,
    **settings,
) -> Plan:
    """The time-optimal pick and place by inverse dynamics: `|mean| + sigmas*std` of the torques within 10 Nm.

    It starts on the straight line in joint space with `duration`, the free control points moved by normal numbers of
    deviation `perturbation`, rad.
    """
    germ = uniform_germ(points, 1)
    fit = least_squares(germ, order)
    payloads = PAYLOAD_MEAN + np.sqrt(3) * PAYLOAD_DEVIATION * germ[:, 0]

    def rows(q, v, a):
        if deterministic:
            torque, low, high = planar_torque(q, v, a, PAYLOAD_MEAN), -PLANAR_TORQUE, PLANAR_TORQUE
            limits = np.full(2, low), np.full(2, high)
        else:
            torque = spread_rows(ca.horzcat(*(planar_torque(q, v, a, m) for m in payloads)), fit, sigmas)
            limits = np.repeat([-np.inf, -PLANAR_TORQUE], 2), np.repeat([PLANAR_TORQUE, np.inf], 2)
        elbow = ca.vertcat(ca.cos(q[0]), ca.sin(q[0]))
        tip = elbow + ca.vertcat(ca.cos(q[0] + q[1]), ca.sin(q[0] + q[1]))
        links = (ca.SX.zeros(2), elbow), (elbow, tip)
        clear = [segment_to_point(*link, ca.DM(DISC_CENTRE)) - DISC_RADIUS for link in links]
        lower, upper = np.append(limits[0], np.zeros(4)), np.append(limits[1], np.full(4, np.inf))
        return ca.vertcat(torque, *clear, elbow[0], tip[0]), lower, upper

    ends = PLANAR_START, PLANAR_GOAL
    guess = straight_line(ends, perturbation, seed), duration
    return solve(rows, ends, PLANAR_INSTANTS, guess=guess, limited_memory=limited_memory, **settings)


def straight_line(ends: tuple[np.ndarray, np.ndarray], perturbation: float = 0.0, seed: int = 0) -> np.ndarray:
    """Free control points (8, joints) evenly spaced between the ends, and moved at random by `perturbation`."""
    share = np.linspace(0, 1, CONTROL_POINTS - 2 * HELD + 2)[1:-1, None]
    points = (1 - share) * ends[0] + share * ends[1]
    return points + perturbation * np.random.default_rng(seed).standard_normal(points.shape)


# --- the six-axis arm -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Link:
    """A joint about its own z and the link behind it, in SI units."""

    origin: np.ndarray  # of the joint's frame in the frame before, and its attitude there
    attitude: np.ndarray
    mass: float
    centre: np.ndarray
    inertia: np.ndarray  # about the centre of mass, in the link's axes
    torque: float
    speed: float
    position: float


def arm() -> list[Link]:
    """The six links of `ARM_DATA`."""
    lines = [line for line in ARM_DATA.read_text().splitlines() if not line.startswith("#")]
    links = []
    for row in csv.DictReader(lines):
        n = {key: float(value) for key, value in row.items() if key != "joint"}
        i = [n[key] for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")]
        links.append(
            Link(
                origin=np.array([n["x"], n["y"], n["z"]]),
                attitude=_attitude(n["roll"], n["pitch"], n["yaw"]),
                mass=n["mass"],
                centre=np.array([n["centre_x"], n["centre_y"], n["centre_z"]]),
                inertia=np.array([[i[0], i[1], i[2]], [i[1], i[3], i[4]], [i[2], i[4], i[5]]]),
                torque=n["torque_limit"],
                speed=n["speed_limit"],
                position=n["position_limit"],
            )
        )
    return links


def _attitude(roll: float, pitch: float, yaw: float) -> np.ndarray:
    (a, b, c), (d, e, f) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    about_x, about_y = np.array([[1, 0, 0], [0, a, -d], [0, d, a]]), np.array([[b, 0, e], [0, 1, 0], [-e, 0, b]])
    turn = np.array([[c, -f, 0], [f, c, 0], [0, 0, 1]]) @ about_y @ about_x
    return np.where(np.abs(turn) < 1e-12, 0.0, turn)  # right angles leave true zeros, which the graph drops


def _turns(links: list[Link], q: ca.SX) -> list[ca.SX]:
    """Attitude of each link in the one before."""
    turns = []
    for n, link in enumerate(links):
        c, s = ca.cos(q[n]), ca.sin(q[n])
        about_z = ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))
        turns.append(ca.DM(link.attitude) @ about_z)
    return turns


def frames(links: list[Link], q: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
    """Position and attitude of each link's frame in the base frame."""
    position, attitude, chain = ca.SX.zeros(3), ca.SX.eye(3), []
    for link, turn in zip(links, _turns(links, q), strict=True):
        position = position + attitude @ ca.DM(link.origin)
        attitude = attitude @ turn
        chain.append((position, attitude))
    return chain


def arm_torque(links: list[Link], q: ca.SX, v: ca.SX, a: ca.SX, payloads: list[tuple[float, float]]) -> ca.SX:
    """Joint torques (6, payloads) by the recursive Newton-Euler algorithm, gravity along -z of the base.

    A payload is a point of a mass at an offset along the last link's z. All share the recursion outward and the
    wrenches of the bare arm; only what a payload adds is brought inward for each.
    """
    turns = _turns(links, q)
    spin, spun, thrust = ca.SX.zeros(3), ca.SX.zeros(3), ca.DM([0, 0, GRAVITY])
    forces, moments = [], []
    for n, (link, turn) in enumerate(zip(links, turns, strict=True)):
        origin, centre, inertia = ca.DM(link.origin), ca.DM(link.centre), ca.DM(link.inertia)
        thrust = turn.T @ (thrust + ca.cross(spun, origin) + ca.cross(spin, ca.cross(spin, origin)))
        spin, spun = turn.T @ spin, turn.T @ spun
        own = ca.vertcat(0, 0, v[n])
        spun = spun + ca.cross(spin, own) + ca.vertcat(0, 0, a[n])
        spin = spin + own
        force = link.mass * (thrust + ca.cross(spun, centre) + ca.cross(spin, ca.cross(spin, centre)))
        forces.append(force)
        moments.append(inertia @ spun + ca.cross(spin, inertia @ spin) + ca.cross(centre, force))
    none = [ca.SX.zeros(3)] * (len(links) - 1)
    bare = _inward(links, turns, forces, moments)
    columns = []
    for mass, offset in payloads:
        point = ca.DM([0, 0, offset])
        force = mass * (thrust + ca.cross(spun, point) + ca.cross(spin, ca.cross(spin, point)))
        columns.append(bare + _inward(links, turns, [*none, force], [*none, ca.cross(point, force)]))
    return ca.horzcat(*columns)


def _inward(links: list[Link], turns: list[ca.SX], forces: list[ca.SX], moments: list[ca.SX]) -> ca.SX:
    """Joint torques that hold the given wrench about each link's origin."""
    torques, force, moment = [], ca.SX.zeros(3), ca.SX.zeros(3)
    for n in reversed(range(len(links))):
        force, moment = force + forces[n], moment + moments[n]
        torques.append(moment[2])
        force = turns[n] @ force
        moment = turns[n] @ moment + ca.cross(ca.DM(links[n].origin), force)
    return ca.vertcat(*reversed(torques))


def segment_to_segment(start: ca.SX, end: ca.SX, other_start: ca.DM, other_end: ca.DM) -> ca.SX:
    """Distance between two segments: the closest points of their lines, brought back to the segments in turn."""
    along, other, gap = end - start, other_end - other_start, start - other_start
    a, b, e = ca.dot(along, along), ca.dot(along, other), ca.dot(other, other)
    c, f = ca.dot(along, gap), ca.dot(other, gap)
    share = _clip((b * f - c * e) / (a * e - b**2 + GUARD))
    other_share = _clip((b * share + f) / e)
    share = _clip((b * other_share - c) / a)
    return ca.sqrt(ca.sumsqr(gap + share * along - other_share * other) + GUARD)


def _clip(share: ca.SX) -> ca.SX:
    return ca.fmax(0, ca.fmin(1, share))


def six_axis_arm(
    sigmas: float = 1.0,
    deterministic: bool = False,
    points: int = 30,
    order: int = 3,
    *,
    duration: float = 2.0,
    perturbation: float = 0.0,
    seed: int = 0,
    limited_memory: bool = False,
    **settings,
) -> Plan:
    """The time-optimal motion of the six-axis arm with an uncertain payload, past a pillar.

    `|mean| + sigmas*std` of the torques within `TORQUE_SHARE` of the catalogue's, speeds and control points within the
    catalogue's, the tool point above the floor, forearm and tool clear of the pillar. Starts as `pick_and_place_time`.
    """
    links = arm()
    germ = uniform_germ(points, 2)
    fit = least_squares(germ, order)
    nominal = [(PAYLOAD_MASS[0], PAYLOAD_OFFSET[0])]
    payloads = [(PAYLOAD_MASS[0] + PAYLOAD_MASS[1] * m, PAYLOAD_OFFSET[0] + PAYLOAD_OFFSET[1] * o) for m, o in germ]
    torques = TORQUE_SHARE * np.array([link.torque for link in links])
    speeds = np.array([link.speed for link in links])
    pillar = [ca.DM(end) for end in PILLAR]

    def rows(q, v, a):
        if deterministic:
            torque, limits = arm_torque(links, q, v, a, nominal), (-torques, torques)
        else:
            torque = spread_rows(arm_torque(links, q, v, a, payloads), fit, sigmas)
            limits = np.append(np.full(6, -np.inf), -torques), np.append(torques, np.full(6, np.inf))
        chain = frames(links, q)
        forearm = [chain[2][0] + chain[2][1] @ ca.DM(end) for end in FOREARM]
        tool = chain[5][0] + chain[5][1] @ ca.DM([0, 0, TOOL_OFFSET])
        clear = ca.vertcat(
            tool[2] - TOOL_FLOOR,
            segment_to_segment(*forearm, *pillar) - FOREARM_RADIUS - PILLAR_RADIUS,
            segment_to_point(*pillar, tool) - TOOL_RADIUS - PILLAR_RADIUS,
        )
        lower = np.concatenate([limits[0], -speeds, np.zeros(3)])
        return ca.vertcat(torque, v, clear), lower, np.concatenate([limits[1], speeds, np.full(3, np.inf)])

    ends = ARM_START, ARM_GOAL
    guess = straight_line(ends, perturbation, seed), duration
    box = np.array([link.position for link in links])
    return solve(rows, ends, ARM_INSTANTS, guess=guess, box=box, limited_memory=limited_memory, **settings)


def main() -> None:
    """Check the arm against MuJoCo, and print what each problem costs with either Hessian."""
    print("largest differences from MuJoCo: torque {:.1e} Nm, clearance {:.1e} m".format(*differences()))
    for problem, spreads in (pick_and_place_time, (1.0, np.sqrt(3))), (six_axis_arm, (1.0, np.sqrt(3))):
        for sigmas, deterministic in (0.0, True), *((a, False) for a in spreads):
            for limited_memory in (True, False):
                plan = problem(sigmas, deterministic, limited_memory=limited_memory)
                print(
                    f"{problem.__name__:20} sigmas {sigmas:.4f} {'L-BFGS' if limited_memory else 'exact':7}"
                    f"{plan.optimum:.6f} s in {plan.iterations} iterations, {plan.construction:.2f} s + "
                    f"{plan.solution:.2f} s, {plan.status}, {plan.evaluations}"
                )


def differences(states: int = 50) -> tuple[float, float]:
    """Largest differences of torques and clearances from MuJoCo's at random states and payloads."""
    import mujoco  # only for this check

    links, random, worst = arm(), np.random.default_rng(0), np.zeros(2)
    q, v, a = (ca.SX.sym(name, 6) for name in "qva")
    pillar = [ca.DM(end) for end in PILLAR]
    chain = frames(links, q)
    forearm = [chain[2][0] + chain[2][1] @ ca.DM(end) for end in FOREARM]
    tool = chain[5][0] + chain[5][1] @ ca.DM([0, 0, TOOL_OFFSET])
    clear = ca.vertcat(segment_to_segment(*forearm, *pillar), segment_to_point(*pillar, tool))
    clearance = ca.Function("clearance", [q], [clear - ca.DM([FOREARM_RADIUS, TOOL_RADIUS]) - PILLAR_RADIUS])
    for _ in range(states):
        payload = random.uniform(1, 3), random.uniform(0, 0.1)
        torque = ca.Function("torque", [q, v, a], [arm_torque(links, q, v, a, [payload])])
        model = mujoco.MjModel.from_xml_string(_mujoco_xml(links, *payload))
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.qacc[:] = random.uniform(-3, 3, (3, 6))
        mujoco.mj_inverse(model, data)
        mine = np.asarray(torque(data.qpos, data.qvel, data.qacc)).reshape(-1)
        gaps = [mujoco.mj_geomDistance(model, data, 0, other, 9.0, None) for other in (1, 2)]
        there = np.asarray(clearance(data.qpos)).reshape(-1)
        apart = np.array(gaps) > 0  # an iterative distance between bodies that overlap is less exact
        errors = np.abs(mine - data.qfrc_inverse).max(), np.abs((there - gaps)[apart]).max(initial=0.0)
        worst = np.maximum(worst, errors)
    return float(worst[0]), float(worst[1])


def _mujoco_xml(links: list[Link], mass: float, offset: float) -> str:
    """The arm with a payload, the capsules and the sphere, as a MuJoCo model."""

    def text(values) -> str:
        return " ".join(repr(float(value)) for value in np.ravel(values))

    def capsule(ends, radius: float) -> str:
        return f'<geom type="capsule" mass="0" fromto="{text(ends)}" size="{radius}"/>'

    bodies = ""
    for n, link in enumerate(links):
        i = link.inertia
        bodies += (
            f'<body pos="{text(link.origin)}" xyaxes="{text(link.attitude[:, :2].T)}"><joint axis="0 0 1"/>'
            f'<inertial pos="{text(link.centre)}" mass="{link.mass}" '
            f'fullinertia="{text([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]])}"/>'
        )
        bodies += capsule(FOREARM, FOREARM_RADIUS) if n == 2 else ""
    bodies += f'<geom type="sphere" mass="0" pos="0 0 {TOOL_OFFSET}" size="{TOOL_RADIUS}"/>'
    bodies += f'<body pos="0 0 {offset}"><inertial pos="0 0 0" mass="{mass}" diaginertia="1e-12 1e-12 1e-12"/></body>'
    return (
        f'<mujoco><compiler angle="radian"/><option gravity="0 0 {-GRAVITY}"><flag contact="disable"/></option>'
        f"<worldbody>{capsule(PILLAR, PILLAR_RADIUS)}{bodies}{'</body>' * len(links)}</worldbody></mujoco>"
    )


if __name__ == "__main__":
    main()
