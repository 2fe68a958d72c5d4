"""The swing-up study: plans for the mean pendulum and for all, the effect of friction, which to build."""

import numpy as np

import aleator as al
from aleator import reporting
from aleator.nlp import HELD
from aleator.reporting import Scene, Table, Text, given, number, share_text
from aleator.studies import _shared as shared
from aleator.studies import swing_up
from aleator.studies._study import Draft
from aleator.studies.swing_up import MASS_2, TORQUE, VARIANCE, deterministic_problem, robust_problem

MEAN, EXPECTED, ENERGY = "deterministic", "robust, expected torque", "robust, expected energy"
FAR = 0.2
"""A tip that ends further than this from upright, m, is a miss."""
LENGTH_1 = 0.5
PENDULUM = shared.Linkage(
    elbow=lambda outputs: LENGTH_1 * np.stack([-np.sin(outputs["q1"]), np.cos(outputs["q1"])], axis=-1),
    posture=(0.0, 0.0),
    target=(0.0, LENGTH_1 + 1.0),
    torques={"τ₁": "q1_torque"},
    limit=TORQUE,
    limits={"q1_torque": (-TORQUE * (1 + HELD), TORQUE * (1 + HELD))},
    scene=Scene(),
)

STARTS = ((3.0, 4, -0.8, 2), (3.0, 5, -0.8, 2), (4.0, 3, -0.8, 2), (3.0, 6, -0.8, 5))
"""Duration (s), half swings, their width (rad), and lateness of the rise, for a motion to start a search from. Later
and wider ones spread the family too far.
"""

PUBLISHED = {
    f"Energy, {MEAN} (J)": ("1060", "27.8 at most"),
    f"Energy, {EXPECTED} (J)": ("310", "30.6 at most"),
    f"Energy, {EXPECTED}, over the first": ("0.292", "–"),
    f"t_f, {MEAN} (s)": ("5.66", "–"),
    f"t_f, {EXPECTED} (s)": ("4.46", "–"),
    f"Norm of the tip's variances at the end, {EXPECTED} (m²)": ("0.0032", "–"),
}
"""Values of the dissertation, whose energies are called powers, and of an independent search."""

TITLE = "Swing-up of a double pendulum: hybrid dynamics"
SUBTITLE = (
    f"Driven at the first joint alone, within ±{given(TORQUE)} N m; mass of the second link in kg: {MASS_2};"
    " dissertation, section 5.5.3"
)
GLOSSARY = (
    ("Deterministic plan", "The swing-up of the mean pendulum that exchanges the least energy (74)."),
    ("Robust plan", "The same for all pendulums: upright in the mean, μ ± σ of the torque within its limits (92)."),
    ("Expected torque", "Minimised: ∫ |E[τ₁] q̇₁| dt, the sum in equation (83)."),
    ("Expected energy", "Minimised: E[∫ |τ₁ q̇₁| dt]."),
    ("Hybrid dynamics", "The first joint follows the plan exactly, the second follows from the dynamics (70), (71)."),
    ("Energy exchanged", "Energy supplied and absorbed both count: ∫ |τ₁ q̇₁| dt."),
)
LEFT_OUT = "the calibration of the margin, and the plan of minimum expected energy"
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

    told = (
        f"To scale, hanging at the start and upright at the target. The mass of the second link in kg: {MASS_2}. Only "
        "the first joint is driven; both have friction."
    )
    page.section("The system", shared.system(page, "swing_up/pendulum.svg", "Double pendulum", told, "5.8"))

    page.section("The plans")
    searches = dict[str, al.results.Starts]()
    for name, problem in page.study.problems.items():
        if not (quick and name == ENERGY):
            # From the problem's own start and several swings, and from the optimum before it.
            swings = [{}, *(swing(*one) for one in STARTS)][:starts]
            earlier = [dict(searches[ENERGY].best.decisions)] if ENERGY in searches else []
            searches[name] = shared.search(page, name, problem, [*earlier, *swings])
    found = searches[EXPECTED].best.decisions
    tried = robust_problem(shared.TRIED, guess=found["motion.q1.free"], duration=float(found["t_final"]))
    margin = None if quick else shared.calibrated(page, tried, ["torque"], trial)
    plans = shared.judged(page, searches, margin, samples, systems)
    families = plans.families
    page.recommend(
        shared.to_build(
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
                for name in (MEAN, EXPECTED if margin is None else shared.CALIBRATED)
            ],
        )
    )
    page.add(reporting.designs_table(plans.solutions, plans.evidence), printed=True)

    page.section("Comparison with published values", compared(plans), printed=True)
    figures = {MEAN: ("5.10", "5.11"), EXPECTED: ("5.13", "5.14")}
    PENDULUM.show(page, plans, (MEAN, EXPECTED), figures, "5.9 and 5.12")

    page.section("The effect of friction", Text(FRICTION))
    if margin is not None:
        page.section("How wide a margin", shared.margin_drawing(margin, "pendulums"))
    shared.add_trust(page, plans.solutions, searches)


def swing(lasting: float, halves: int, width: float, late: int) -> dict[str, np.ndarray | float]:
    """A motion that rises `late`, superposed with `halves` half swings of growing width."""
    fractions = np.linspace(0.0, 1.0, 80)
    angle = -np.pi * (1 - fractions**late) + width * np.sin(halves * np.pi * fractions) * fractions
    free = al.fit_control_points(angle, swing_up.FREE, degree=swing_up.DEGREE, **swing_up.ENDS)
    return {"motion.q1.free": free, "t_final": lasting}


def ends(family: al.results.Motions) -> np.ndarray:
    """The places of the tips at the end, shape (2, systems), m."""
    return np.stack([family.systems[name][:, -1] for name in swing_up.TIP])


def missed(family: al.results.Motions) -> str:
    """The share of systems that end too far from upright."""
    far = np.hypot(*(ends(family) - np.array(PENDULUM.target)[:, None])) > FAR
    return share_text(al.results.Proportion(int(far.sum()), len(far)))


def compared(plans: shared.Plans) -> Table:
    """Published values and those of an independent search, compared with ours."""
    energies = {name: plan.objective for name, plan in plans.solutions.items()}
    ours = {f"Energy, {name} (J)": number(one, 4) for name, one in energies.items()}
    ours[f"Energy, {EXPECTED}, over the first"] = number(energies[EXPECTED] / energies[MEAN], 3)
    ours |= {f"t_f, {name} (s)": number(float(one.instants[-1]), 3) for name, one in plans.solutions.items()}
    for name, family in plans.families.items():
        ours[f"Norm of the tip's variances at the end, {name} (m²)"] = number(
            np.hypot(*ends(family).var(axis=1, ddof=1)), 3
        )
    note = (
        "The published numbers, called powers, in W, are sums over an unstated number of samples for another friction. "
        "Reference: an independent search. Variances are those of the random pendulums flown, limited to "
        f"{given(VARIANCE, 'm²')} in the robust plans only. Powers are rounded off where they are zero, by at most "
        f"{given(swing_up.SMOOTHING)} J a second."
    )
    return shared.comparison(("Published", "Reference", "Ours"), PUBLISHED, ours, note)
