"""The study of pick and place with minimum effort: its plans, the front between two of them, and a wider payload."""

import numpy as np
import scipy
from jaxtyping import Float

import aleator as al
from aleator import reporting
from aleator.journalling import kept
from aleator.reporting import Drawing, Table, Text, given, number, percent, share_text
from aleator.studies import _motion as motion
from aleator.studies import pick_and_place_effort as effort
from aleator.studies._shared import margin_drawing
from aleator.studies._study import Draft
from aleator.studies.two_link_arm import TORQUE
from aleator.studies.two_link_arm._views import ARM, TORQUES, arm_schematic
from aleator.transcription import transcribe

MEAN, ROBUST, LEAST = "deterministic", "robust", "least variance"
UNIT = "(N m)² s"
WIDE = al.Uniform(1.0, std=0.5)
"""A payload with five times the spread."""
BENDS = (1.2, 0.6, 2.5)
"""The bend of the elbow on the paths from which searches start, besides the problem's own, rad."""
MOST = 2 * TORQUE**2 * effort.DURATION
"""The effort of both torques at their limits throughout: no plan takes more."""

PUBLISHED = {MEAN: 2770.0, ROBUST: 3530.0, LEAST: 5910.0}
PUBLISHED_SPREADS = {MEAN: "–", ROBUST: "0.191 and 0.133", LEAST: "0.144 and 0.114"}
"""Efforts in the dissertation, and σ of the tip's x and y at the end, m."""
REFERENCE = {MEAN: 106.34, ROBUST: 112.12, LEAST: 200.4}
REFERENCE_NORM = 0.02533
"""Efforts by an independent program for the same arm, and its smallest norm of the tip's variances, m²."""

TITLE = "Pick and place with minimum effort: forward dynamics"
SUBTITLE = (
    f"Two-link arm, payload in kg: {effort.PAYLOAD}; {given(effort.DURATION)} s, torques within ±{given(TORQUE)} N m;"
    " dissertation, section 5.5.1"
)
GLOSSARY = (
    ("Deterministic plan", "The minimum effort that brings the mean payload to its target (72)."),
    (
        "Robust plan",
        "The minimum effort that does so in the mean, with one σ of clearance from obstacle and wall, (79) and (90).",
    ),
    ("Least variance", "Under the same limits, the minimum norm of the tip's variances at the end (86)."),
    ("Effort", f"∫ τ₁² + τ₂² dt, {UNIT}."),
    ("Forward dynamics", "The torques act as planned, open loop; the payload changes where the arm goes."),
    ("Leave-one-out error", "Of predicting one collocation point from all others, relative to the variance."),
)
LEFT_OUT = "the plan of least variance, its front, plans with limits at the instants alone, and a wider payload"
LESSON = (
    (
        "The dissertation's payload has a standard deviation of 0.5 kg. The same torques then send a light and a heavy "
        "payload to quite different places, and the joint angles as functions of the payload are too strongly curved "
        "for a polynomial of order 5. The expansion's leave-one-out error shows this."
    ),
    "The remedy is feedback, or planning the motion instead of the torques: see the study pick-and-place-time.",
)


def problems() -> dict[str, al.Problem]:
    """The problems of the plans."""
    return {
        MEAN: effort.deterministic_problem(),
        ROBUST: effort.robust_problem(),
        LEAST: effort.terminal_variance_problem(MOST),
    }


def chapter(page: Draft, quick: bool) -> None:
    """Section 5.5.1, and the margin to build with, which it leaves open."""
    starts, samples, systems, trial = (1, 2_000, 400, 2_000) if quick else (4, 20_000, 2_000, 10_000)

    page.section("The system")
    page.add(arm_schematic(page, effort.PAYLOAD))

    page.section("The plans")
    # Deterministic from bent paths; the others from the plan before them, and from these paths as well.
    bent = [{}, *({"torque.free": effort.start_torques(bend)} for bend in BENDS)][:starts]
    searches = dict[str, al.results.Starts]()
    for name, problem in page.study.problems.items():
        if not (quick and name == LEAST):
            earlier = [dict(one.best.decisions) for one in searches.values()][-1:]
            searches[name] = motion.search(page, name, problem, [*earlier, *bent[len(earlier) :]])
    tried = effort.robust_problem(motion.TRIED, guess=searches[ROBUST].best.decisions["torque.free"])
    margin = motion.calibrated(page, tried, ["obstacle", "wall"], trial)
    plans = motion.judged(page, searches, margin, samples, systems)
    families, robust = plans.families, plans.solutions[ROBUST]
    page.recommend(
        motion.to_build(
            margin,
            robust,
            plans.evidence[ROBUST],
            labels={"torque.free": "both torques as splines of"},
            who="payloads",
            objective="effort",
            not_verified=["the inertias and the obstacle of the dissertation, which are not published"],
            sentences=[
                f"With one σ of clearance {share_text(plans.evidence[ROBUST].violations['obstacle'])} of the payloads "
                "hit the obstacle: for a uniform distribution 21.1 % lie beyond one σ on one side.",
                f"At the end the tip has σ = {spread(plans, motion.CALIBRATED)} m in x and y, which clearance does not "
                "reduce, and no open-loop plan brings to zero: feedback has to do the rest.",
            ],
        )
    )
    page.add(reporting.designs_table(plans.solutions, plans.evidence), printed=True)

    page.section("Comparison with published values")
    coarse = {} if quick else motion.held_at_instants(page, plans.solutions, (MEAN, ROBUST))
    page.add(published_table(plans, coarse), printed=True)

    page.section("The motion")
    page.add(
        ARM.animation(plans, (MEAN, ROBUST)),
        Drawing(
            [ARM.paths(name, one, plans) for name, one in families.items()],
            "Path of the tip",
            "With another payload, the same torques lead elsewhere. Arms that touch obstacle or wall, with either "
            "link, are highlighted.",
        ),
    )

    page.section("Where the arm goes")
    for name, figure in ((MEAN, "5.2"), (ROBUST, "5.3"), (LEAST, "5.4")):
        if name in families:
            histories, heading = ARM.histories(families[name]), f"{name.capitalize()} plan on its family"
            page.add(Drawing(histories, heading, f"Rings: the target. {motion.SHADES}", figure))
    torques = [motion.torques_figure(one, TORQUES, TORQUE, name.capitalize()) for name, one in families.items()]
    page.add(Drawing(torques, "Torques", "They act as planned on every arm, and so have no spread."))

    if not quick:
        page.section("Effort against spread")
        bare = effort.terminal_variance_problem(MOST, guess=plans.solutions[LEAST].decisions["torque.free"])
        # From where more effort brings no gain down to that of the robust plan.
        efforts = np.linspace(effort_of(families[LEAST]), 1.01 * robust.objective, 7)
        fronts = {LEAST: al.pareto(bare, "effort", efforts, progress=page.progress)}
        page.keep("front", fronts[LEAST])
        figure = reporting.front_figure(
            fronts, x="Effort allowed", x_unit=UNIT, y="Norm of the tip's variances", y_unit="m²"
        )
        told = (
            "Each point is the plan with the smallest spread of the tip for its effort. The first increases beyond the "
            "robust plan's effort gain most; at the right end the torques are at their limits wherever that helps."
        )
        page.add(reporting.linked_front(fronts, [figure], "The cost of a smaller spread", told))

        page.section("How wide a payload")
        thrown = motion.flown(f"payload {WIDE}", robust, systems, effort.robust_problem(payload=WIDE))
        page.add(
            Text(LESSON, lead="No single open-loop plan suits widely spread payloads."),
            spreads_table(robust, [(effort.PAYLOAD, families[ROBUST]), (WIDE, thrown)]),
            Drawing(
                [ARM.histories(thrown)[0], ARM.paths(ROBUST, thrown, plans)],
                f"The robust plan with payload {WIDE}",
                motion.SHADES,
            ),
        )

    page.section("How wide a margin")
    page.add(margin_drawing(margin, "The margin for a tolerated share of violations", "payloads"))
    motion.add_trust(page, searches, plans)


def effort_of(family: al.results.Motions) -> float:
    """`∫ τ₁² + τ₂² dt` of a plan, (N m)² s, by Simpson's rule on its instants; the torques of all arms are the same."""
    squares = sum(family.systems[name][0] ** 2 for name in TORQUES.values())
    return float(scipy.integrate.simpson(squares, x=family.times))


def spread(plans: motion.Plans, name: str) -> str:
    """The standard deviations of the tip's final position, x and y, m: `0.191 and 0.133`."""
    return " and ".join(number(float(plans.families[name].moments[output].std[-1]), 3) for output in effort.TIP)


def published_table(plans: motion.Plans, coarse: dict[str, float]) -> Table:
    """Published values and those of an independent program, compared with ours."""
    ours = {name: effort_of(family) for name, family in plans.families.items()}
    columns = motion.over_the_first("Effort", PUBLISHED, ours)
    for name, column in columns.items():
        column[f"Effort, {UNIT}, reference"] = number(REFERENCE[name], 5)
        column["– ours, with limits at the instants"] = number(coarse.get(name, np.nan), 5)
        column["– ours, between the instants too"] = number(ours[name], 5)
        if name == LEAST:
            column["Norm of the tip's variances, m², reference"] = number(REFERENCE_NORM, 4)
            column["– ours, norm"] = number(plans.solutions[name].objective, 4)
        column["σ of the tip's x and y at the end, m, published"] = PUBLISHED_SPREADS[name]
        column["– ours, σ"] = spread(plans, name)
    note = (
        "Reference: an independent program for the same arm, with limits only at the 61 instants. The published "
        "efforts are sums over an unstated number of samples, for another inertia model, another obstacle and a "
        "payload with a standard deviation of 0.5 kg."
    )
    return reporting.side_by_side("Published and reference values compared with ours", columns, note)


def spreads_table(plan: al.Solution, families: list[tuple[al.Uniform, al.results.Motions]]) -> Table:
    """The joints' standard deviations at the end by payload: sampled, and by the expansion with its error."""
    rows = []
    for payload, family in families:
        resolved = kept(f"expansion, payload {payload}", ends, effort.robust_problem(payload=payload), plan.vector)
        for name, (std, error) in resolved.items():
            sampled = float(family.moments[name].std[-1])
            rows.append([f"{name}(t_f), {payload}", number(sampled, 3), number(std, 3), percent(error)])
    header = ["", "σ sampled (rad)", "σ by order 5 (rad)", "Leave-one-out error"]
    note = (
        f"Above {given(100 * effort.TOLERANCE)} % an output counts as unresolved: a solve warns, and means and "
        "standard deviations are not to be trusted."
    )
    return Table("The robust plan with the payload of this study and with a wider one", header, rows, note)


def ends(problem: al.Problem, decisions: Float[np.ndarray, " n"]) -> dict[str, tuple[float, float]]:
    """The standard deviation of each joint's final angle by the expansion, rad, and its leave-one-out error."""
    resolved = transcribe(problem).resolve(decisions)
    each = {name: resolved[f"{name}(t_f)"] for name in ("q1", "q2")}
    return {name: (float(one.std), float(one.leave_one_out)) for name, one in each.items()}
