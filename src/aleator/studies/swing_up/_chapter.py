"""The swing-up study: plans for the mean pendulum and for all, the effect of friction, which to build."""

from typing import Any

import equinox as eqx
import numpy as np

import aleator as al
from aleator import reporting
from aleator.nlp import HELD
from aleator.references._estimate import estimate, group_count
from aleator.reporting import Drawing, Scene, Table, Text, given, number, share_text
from aleator.studies import _motion as motion
from aleator.studies import swing_up
from aleator.studies._shared import margin_drawing, system
from aleator.studies._study import Draft
from aleator.studies.swing_up import MASS_2, TORQUE, VARIANCE, deterministic_problem, robust_problem

MEAN, EXPECTED, ENERGY = "deterministic", "robust, expected torque", "robust, expected energy"
FAR = 0.2
"""A tip that ends further than this from upright, m, is a miss."""
LENGTH_1 = 0.5
PENDULUM = motion.Linkage(
    elbow=lambda outputs: LENGTH_1 * np.stack([-np.sin(outputs["q1"]), np.cos(outputs["q1"])], axis=-1),
    posture=(0.0, 0.0),
    target=(0.0, LENGTH_1 + 1.0),
    scene=Scene(),
    broken=lambda family: np.abs(family.systems["q1_torque"]).max(axis=1) > TORQUE * (1 + HELD),
)

STARTS = ((3.0, 4, -0.8, 2), (3.0, 5, -0.8, 2), (4.0, 3, -0.8, 2), (3.0, 6, -0.8, 5))
"""Duration (s), half swings, their width (rad), and lateness of the rise, for a motion to start a search from. Later
and wider ones spread the family too far.
"""

PUBLISHED = {MEAN: 1060.0, EXPECTED: 310.0}
PUBLISHED_ENDS = {MEAN: ("5.66", "–"), EXPECTED: ("4.46", "0.0032")}
"""In the dissertation: "powers" (W); durations (s) and the norm of the tip's variances at the end (m²)."""
REFERENCE = {MEAN: 27.8, EXPECTED: 30.6}
"""The energies of an independent search, J: ours are at most these."""

TITLE = "Swing-up of a double pendulum: hybrid dynamics"
SUBTITLE = (
    f"Driven at the first joint alone, within ±{given(TORQUE)} N m; mass of the second link in kg: {MASS_2};"
    " dissertation, section 5.5.3"
)
GLOSSARY = (
    ("Deterministic plan", "The swing-up of the mean pendulum that exchanges the least energy (74)."),
    (
        "Robust plan",
        "The same for all pendulums: upright in the mean, with μ ± σ of the torque within its limits (92).",
    ),
    ("Expected torque", "Minimised: ∫ |E[τ₁] q̇₁| dt, the sum in equation (83)."),
    ("Expected energy", "Minimised: E[∫ |τ₁ q̇₁| dt]."),
    ("Hybrid dynamics", "The first joint follows the plan exactly, the second follows from the dynamics (70), (71)."),
    ("Energy exchanged", "Energy supplied and absorbed both count: ∫ |τ₁ q̇₁| dt."),
)
LEFT_OUT = "the calibration of the margin, the plan of minimum expected energy, and the effect of friction"
FRICTION = (
    (
        "The motion of the first joint is given, so the second link obeys its own equation, in which every term but "
        "friction is proportional to its mass: inertia, weight, and the coupling force of the first link. Without "
        "friction the mass cancels, all pendulums of the family swing alike, and the tip has no spread."
    ),
    (
        "Friction also determines the energy: without it energy is conserved, so that any motion that never brakes "
        "costs the same, the difference in potential energy. With it, every second costs energy."
    ),
)


def problems() -> dict[str, al.Problem]:
    """The problems of the plans, each with its own start."""
    return {
        MEAN: deterministic_problem(),
        ENERGY: robust_problem(expected="energy"),
        EXPECTED: robust_problem(expected="torque"),
    }


def chapter(page: Draft, quick: bool) -> None:
    """Section 5.5.3, and the margin to build with, which it leaves open."""
    starts, samples, systems, trial = (1, 1_000, 200, 0) if quick else (5, 20_000, 2_000, 5_000)

    page.section("The system")
    told = (
        f"To scale, hanging at the start and upright at the target. The mass of the second link in kg: {MASS_2}. Only "
        "the first joint is driven; both have friction."
    )
    page.add(system(page, "swing_up/pendulum.svg", "Double pendulum", told, "5.8"))

    page.section("The plans")
    searches = dict[str, al.results.Starts]()
    for name, problem in page.study.problems.items():
        if not (quick and name == ENERGY):
            # From the problem's own start and several swings, and from the optimum before it.
            swings = [{}, *(swing(*one) for one in STARTS)][:starts]
            earlier = [dict(searches[ENERGY].best.decisions)] if ENERGY in searches else []
            searches[name] = motion.search(page, name, problem, [*earlier, *swings])
    margin = None if quick else motion.calibrated(page, tried(searches[EXPECTED].best), ["torque"], trial)
    plans = motion.judged(page, searches, margin, samples, systems)
    families = plans.families
    page.recommend(
        motion.to_build(
            margin,
            plans.solutions[EXPECTED],
            plans.evidence[EXPECTED],
            labels={"t_final": "a swing-up of", "motion.q1.free": "the first joint's spline of"},
            who="pendulums",
            objective="energy",
            not_verified=["friction and inertias of the dissertation, which are not published"],
            sentences=[
                f"Of the pendulums flown with the {name} plan {missed(families[name])} end more than "
                f"{given(FAR, 'm')} from upright, which no limit on single pendulums covers."
                for name in (MEAN, EXPECTED if margin is None else motion.CALIBRATED)
            ],
        )
    )
    page.add(reporting.designs_table(plans.solutions, plans.evidence), printed=True)

    page.section("Comparison with published values")
    page.add(published_table(plans), printed=True)

    page.section("The motion")
    page.add(
        PENDULUM.animation(plans, (MEAN, EXPECTED), "5.9 and 5.12"),
        Drawing(
            [PENDULUM.paths(name, one, plans) for name, one in families.items() if name != ENERGY],
            "Path of the tip",
            "The first joint moves alike in all systems; the tips diverge as the second links swing. Cross: upright.",
        ),
    )
    for heading, name, torque, joint in (
        ("The deterministic plan on the family", MEAN, "5.10", "5.11"),
        ("The robust plan", EXPECTED, "5.13", "5.14"),
    ):
        page.section(heading)
        figure = motion.torques_figure(families[name], {"τ₁": "q1_torque"}, TORQUE)
        figures = PENDULUM.histories(families[name])
        page.add(
            Drawing([figure], "Torque over time", motion.SHADES, torque),
            Drawing(figures, "Joints and tip over time", f"Rings: the target. {motion.SHADES}", joint),
        )

    if margin is not None:
        page.section("The effect of friction")
        whole: Any = al.uncertain(plans.solutions[EXPECTED].problem)
        frictionless = eqx.tree_at(lambda tree: tree.system.model.damping, whole, 0.0)
        free = motion.flown("without friction", plans.solutions[EXPECTED], systems, frictionless)
        told = (
            f"The norm of the tip's variances at the end is {terminal_norm(families[EXPECTED])} m² under the robust "
            f"plan, and {terminal_norm(free)} m² under the same plan without friction."
        )
        page.add(Text([*FRICTION, told]))

        page.section("How wide a margin")
        page.add(margin_drawing(margin, "The margin for a tolerated share of violations", "pendulums"))
    motion.add_trust(page, searches, plans)


def swing(lasting: float, halves: int, width: float, late: int) -> dict[str, np.ndarray | float]:
    """A motion that rises `late`, superposed with `halves` half swings of growing width."""
    fractions = np.linspace(0.0, 1.0, 80)
    angle = -np.pi * (1 - fractions**late) + width * np.sin(halves * np.pi * fractions) * fractions
    free = al.fit_control_points(angle, swing_up.FREE, degree=swing_up.DEGREE, **swing_up.ENDS)
    return {"motion.q1.free": free, "t_final": lasting}


def tried(plan: al.Solution) -> al.Problem:
    """The problem of minimum energy of the expected torque, to be solved from a plan."""
    guess, lasting = plan.decisions["motion.q1.free"], float(plan.decisions["t_final"])
    return robust_problem(motion.TRIED, guess=guess, duration=lasting)


def tips(family: al.results.Motions) -> np.ndarray:
    """The places of the tips at the end, shape (systems, 2), m."""
    return np.stack([family.systems[name][:, -1] for name in swing_up.TIP], axis=1)


def missed(family: al.results.Motions) -> str:
    """The share of systems that end too far from upright."""
    far = np.hypot(*(tips(family) - PENDULUM.target).T) > FAR
    return share_text(al.results.Proportion(int(far.sum()), len(far)))


def terminal_norm(family: al.results.Motions) -> str:
    """The norm of the tip's variances at the end, m², and one standard error of it."""
    ends = tips(family)
    norm = estimate(lambda sample: np.hypot(*sample.var(axis=0, ddof=1)), ends, group_count(len(ends)))
    return f"{number(float(norm.value), 3)} ± {number(float(norm.standard_error), 2)}"


def published_table(plans: motion.Plans) -> Table:
    """Published values and those of an independent search, compared with ours."""
    ours = {name: plan.objective for name, plan in plans.solutions.items()}
    columns = motion.over_the_first("Energy", PUBLISHED, ours)
    for name, column in columns.items():
        lasting, variance = PUBLISHED_ENDS[name]
        column["Energy (J), reference"] = f"{REFERENCE[name]} at most"
        column["– ours"] = number(ours[name], 4)
        column["t_f (s), published"] = lasting
        column["– ours, t_f"] = number(float(plans.solutions[name].instants[-1]), 3)
        column["Norm of the tip's variances at the end (m²), published"] = variance
        column["– ours, norm"] = terminal_norm(plans.families[name])
    note = (
        f"The published numbers, {' and '.join(map(given, PUBLISHED.values()))}, are called powers, in W, and are sums "
        "over an unstated number of samples for another friction. Reference: the results of an independent search. "
        "Variances are those of the random pendulums flown, ± one standard error of that sample; the true one is "
        f"limited to {given(VARIANCE, 'm²')} in the robust plans only. Powers are rounded off where they are zero, "
        f"which lowers an energy by at most {given(swing_up.SMOOTHING)} J a second."
    )
    return reporting.side_by_side("Published and reference values compared with ours", columns, note)
