"""The swing-up study: plans for the mean pendulum and for all, finer steps, the effect of friction, which to build."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np

import aleator as al
from aleator.nlp import HELD
from aleator.references._estimate import estimate, group_count
from aleator.reporting import (
    Code,
    Drawing,
    Scene,
    Schematic,
    Table,
    Text,
    designs_table,
    given,
    number,
    percent,
    share_text,
)
from aleator.studies._motion import (
    CALIBRATED,
    SHADES,
    TRIED,
    Linkage,
    add_trust,
    calibrated,
    compared,
    counted,
    duration,
    flown,
    search,
    to_build,
    torques_figure,
)
from aleator.studies._shared import margin_drawing, picture
from aleator.studies._study import Draft
from aleator.studies.swing_up import (
    DEGREE,
    ENDS,
    FREE,
    MASS_2,
    SMOOTHING,
    STEPS,
    TORQUE,
    VARIANCE,
    deterministic_problem,
    robust_problem,
)

MEAN, EXPECTED, ENERGY = "deterministic", "robust, expected torque", "robust, expected energy"
NAMES = (MEAN, ENERGY, EXPECTED, CALIBRATED)
FAR = 0.2
"""A tip that ends further than this from upright, m, is a miss."""
FINER = 4
"""The refinement factor for checking the problem's steps."""
LENGTH_1 = 0.5
PENDULUM = Linkage(
    elbow=lambda outputs: LENGTH_1 * np.stack([-np.sin(outputs["q1"]), np.cos(outputs["q1"])], axis=-1),
    posture=(0.0, 0.0),
    target=(0.0, LENGTH_1 + 1.0),
    scene=Scene(),
)

STARTS = (
    (3.0, 6, 0.8, 5),
    (4.0, 4, -0.8, 5),
    (3.0, 4, -0.8, 2),
    (4.0, 4, -0.8, 2),
    (3.0, 3, 0.8, 2),
    (4.0, 3, -0.8, 2),
    (3.0, 5, -0.8, 2),
)
"""Duration (s), half swings, their width (rad), and lateness of the rise, for a motion to start a search from."""
FAMILY_STARTS = ((3.0, 4, -0.8, 2), (3.0, 5, -0.8, 2), (4.0, 3, -0.8, 2), (3.0, 6, -0.8, 5))
"""The swings from which searches for the whole family start: late and wide ones spread it too far."""

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
    ("Miss", f"The tip ends more than {given(FAR, 'm')} from its upright position."),
)
LEFT_OUT = "the calibration of the margin, the plan of minimum expected energy, finer steps, and the effect of friction"
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
    starts, samples, systems, trial = (1, 1_000, 200, 0) if quick else (7, 20_000, 2_000, 5_000)

    page.section("The system")
    page.add(
        Schematic(
            [picture("swing_up/pendulum.svg")],
            "Double pendulum",
            f"To scale, hanging at the start and upright at the target. The mass of the second link in kg: {MASS_2}."
            " Only the first joint is driven; both have friction.",
            "5.8",
            [Code(f"{name.capitalize()} as mathematics", str(one)) for name, one in page.study.problems.items()],
        )
    )

    page.section("The plans")
    searches, plans = dict[str, al.results.Starts](), dict[str, al.Solution]()
    for name, problem in page.study.problems.items():
        if not (quick and name == ENERGY):
            # From the problem's own start and several swings, and from the optimum before it.
            swings = [{}, *(swing(*one) for one in (STARTS if name == MEAN else FAMILY_STARTS))][:starts]
            earlier = [dict(plans[ENERGY].decisions)] if ENERGY in plans else []
            searches[name] = search(page, name, problem, [*earlier, *swings])
            plans[name] = searches[name].best
    margin = None if quick else calibrated(page, margin_problem(plans[EXPECTED]), ["torque"], trial)
    if margin is not None:
        plans[CALIBRATED] = margin.solution
    evidence = counted(page, plans, samples, margin)
    families = {name: flown(name, plan, systems) for name, plan in plans.items()}
    page.recommend(
        to_build(
            margin,
            plans[EXPECTED],
            evidence[EXPECTED],
            labels={"t_final": "a swing-up of", "motion.q1.free": "the first joint's spline of"},
            who="pendulums",
            objective="energy",
            not_verified=["friction and inertias of the dissertation, which are not published"],
            sentences=[*sentences(plans, evidence, families)],
        )
    )
    page.add(designs_table(plans, evidence), printed=True)

    page.section("Comparison with published values")
    page.add(published_table(plans, families), printed=True)

    page.section("The motion")
    page.add(
        PENDULUM.animation({name: families[name] for name in (MEAN, EXPECTED)}, NAMES, "5.9 and 5.12"),
        Drawing(
            [PENDULUM.paths(name, one, overloads(one), NAMES) for name, one in families.items() if name != ENERGY],
            "Path of the tip",
            "The first joint moves alike in all systems; the tips diverge as the second links swing. Cross: upright.",
        ),
    )
    for heading, name, torque, joint in (
        ("The deterministic plan on the family", MEAN, "5.10", "5.11"),
        ("The robust plan", EXPECTED, "5.13", "5.14"),
    ):
        page.section(heading)
        figure = torques_figure(families[name], {"τ₁": "q1_torque"}, TORQUE)
        figures = PENDULUM.histories(families[name])
        page.add(
            Drawing([figure], "Torque over time", SHADES, torque),
            Drawing(figures, "Joints and tip over time", f"Rings: the target. {SHADES}", joint),
        )

    if margin is not None:
        page.section("Accuracy of the steps, and the effect of friction")
        variants = list[tuple[str, al.results.Motions]]()
        for i, (name, plan) in enumerate(plans.items()):
            page.progress(f"finer steps, {name}", i, len(plans))
            whole: Any = al.uncertain(plan.problem)
            finer = whole.on_grid(whole.grid.finer(FINER))
            frictionless = eqx.tree_at(lambda tree: tree.system.model.damping, whole, 0.0)
            variants += [
                (f"{name}, {STEPS} steps", families[name]),
                (f"{FINER * STEPS} steps", flown(f"{name}, finer steps", plan, systems, finer)),
                ("without friction", flown(f"{name}, without friction", plan, systems, frictionless)),
            ]
        page.add(variants_table(variants), Text(FRICTION))

        page.section("How wide a margin")
        page.add(margin_drawing(margin, "The margin for a tolerated share of violations", "pendulums"))

    add_trust(page, searches, plans)


def swing(lasting: float, halves: int, width: float, late: int) -> dict[str, np.ndarray | float]:
    """A motion that rises `late`, superposed with `halves` half swings of growing width."""
    fractions = np.linspace(0.0, 1.0, 80)
    angle = -np.pi * (1 - fractions**late) + width * np.sin(halves * np.pi * fractions) * fractions
    return {"motion.q1.free": al.fit_control_points(angle, FREE, degree=DEGREE, **ENDS), "t_final": lasting}


def margin_problem(plan: al.Solution) -> al.Problem:
    """The problem of minimum energy of the expected torque, to be solved from a plan."""
    guess, lasting = plan.decisions["motion.q1.free"], float(plan.decisions["t_final"])
    return robust_problem(TRIED, guess=guess, duration=lasting)


def overloads(family: al.results.Motions) -> np.ndarray:
    """Which systems need more torque than available, at an instant."""
    return np.abs(family.systems["q1_torque"]).max(axis=1) > TORQUE * (1 + HELD)


def tips(family: al.results.Motions) -> np.ndarray:
    """The places of the tips at the end, shape (systems, 2), m."""
    return np.stack([family.systems[name][:, -1] for name in ("tip_x", "tip_y")], axis=1)


def missed(family: al.results.Motions) -> str:
    """The share of systems that end too far from upright."""
    far = np.hypot(*(tips(family) - PENDULUM.target).T) > FAR
    return share_text(al.results.Proportion(int(far.sum()), len(far)))


def terminal_norm(family: al.results.Motions) -> str:
    """The norm of the tip's variances at the end, m², and one standard error of it."""
    ends = tips(family)
    norm = estimate(lambda sample: np.hypot(*sample.var(axis=0, ddof=1)), ends, group_count(len(ends)))
    return f"{number(float(norm.value), 3)} ± {number(float(norm.standard_error), 2)}"


def sentences(
    plans: Mapping[str, al.Solution],
    evidence: Mapping[str, al.results.Evidence],
    families: Mapping[str, al.results.Motions],
) -> Iterator[str]:
    """How the deterministic plan and the published margin fail, and what the limits do not cover."""
    yield (
        "Do not use the deterministic plan: flown on the family, it breaks the torque limit in"
        f" {share_text(evidence[MEAN].joint)} of the cases and misses the target by more than {given(FAR, 'm')} in"
        f" {missed(families[MEAN])}."
    )
    more = percent(plans[EXPECTED].objective / plans[MEAN].objective - 1)
    yield (
        f"The robust plan with the published margin, a = 1, swings the family up with {more} more energy, but "
        f"{share_text(evidence[EXPECTED].joint)} of the pendulums need more torque than available."
    )
    if CALIBRATED in families:
        yield (
            f"Of the pendulums flown with the calibrated plan {missed(families[CALIBRATED])} end more than "
            f"{given(FAR, 'm')} from upright, which no limit of the problem covers."
        )
        pair = [plans[name] for name in (EXPECTED, ENERGY)]
        first, second = (f"{number(one.objective, 4, 'J')} in {number(duration(one), 3, 's')}" for one in pair)
        yield (
            f"Whether the energy of the expected torque is minimised ({first}) or the expected energy ({second}) makes "
            "little difference: the torque spreads little where power flows."
        )


def published_table(plans: Mapping[str, al.Solution], families: Mapping[str, al.results.Motions]) -> Table:
    """Published values and those of an independent search, compared with ours."""
    rows, ours = [], {name: plans[name].objective for name in PUBLISHED}
    for name, (time, variance) in PUBLISHED_ENDS.items():
        energies = given(PUBLISHED[name]), f"{REFERENCE[name]} at most", number(ours[name], 4)
        rows.append([name, *energies, time, number(duration(plans[name]), 3), variance, terminal_norm(families[name])])
    note = (
        "The published numbers are called powers, in W, and are sums over an unstated number of samples for another "
        f"friction. {compared(PUBLISHED, ours, 'the energies')} Reference: the results of an independent search. "
        "Variances are those of the random pendulums flown, ± one standard error of that sample; the true one is "
        f"limited to {given(VARIANCE, 'm²')} in the robust plans only. Powers are rounded off where they are zero, "
        f"which lowers an energy by at most {given(SMOOTHING)} J a second."
    )
    header = ["", "Published (W)", "Reference (J)", "Ours (J)", "Published t_f (s)", "Ours (s)"]
    header += ["Published variance (m²)", "Ours (m²)"]
    return Table("Published and reference values compared with ours", header, rows, note)


def variants_table(variants: Sequence[tuple[str, al.results.Motions]]) -> Table:
    """The same pendulums with the problem's steps, with finer ones, and without friction."""
    rows = []
    for label, family in variants:
        ends, torque = [family.moments[joint] for joint in ("q2", "q2_rate")], family.moments["q1_torque"]
        errors = [float(one.std[-1]) / np.sqrt(len(tips(family))) for one in ends]
        means = [f"{number(float(one.mean[-1]), 3)} ± {number(e, 2)}" for one, e in zip(ends, errors, strict=True)]
        largest = number(float(np.max(np.abs(torque.mean) + torque.std)), 4)
        rows.append([label, *means, number(float(ends[0].std[-1]), 2), terminal_norm(family), largest])
    header = ["", "E[q₂(t_f)] (rad)", "E[q̇₂(t_f)] (rad/s)", "σ[q₂(t_f)] (rad)", "Variance of the tip (m²)"]
    header += ["Largest |μ| + σ of τ₁ (N m)"]
    note = (
        f"The same random pendulums, integrated with RK4 in {STEPS} steps and in {FINER} times as many; ± is one "
        "standard error of that sample, which the first two rows of a plan share: their differences are "
        "integration errors and, in the last column, mainly the peaks between the coarser instants. The robust plans "
        f"require true means of zero and a true variance of at most {given(VARIANCE, 'm²')}: deviations within the "
        "sample's error do not contradict that. The deterministic plan swings up the pendulum of mean mass, not the "
        "mean of all."
    )
    return Table("The plans with finer steps, and without friction", header, rows, note)
