"""The study of pick and place with minimum effort: its plans, and a wider payload."""

import numpy as np
from jaxtyping import Float

import aleator as al
from aleator import reporting
from aleator.journalling import kept
from aleator.reporting import Drawing, Table, Text, given, number, percent, share_text
from aleator.studies import _shared as shared
from aleator.studies import pick_and_place_effort as effort
from aleator.studies._study import Draft
from aleator.studies.two_link_arm import TORQUE
from aleator.studies.two_link_arm._views import ARM, arm_schematic
from aleator.transcription import transcribe

MEAN, ROBUST, LEAST = "deterministic", "robust", "least variance"
UNIT = "(N m)² s"
WIDE = al.Uniform(1.0, std=0.5)
"""A payload with five times the spread."""
BENDS = (1.2, 0.6, 2.5)
"""The bend of the elbow on the paths from which searches start, besides the problem's own, rad."""
MOST = 2 * TORQUE**2 * effort.DURATION
"""The effort of both torques at their limits throughout: no plan takes more."""

PUBLISHED = {
    f"Effort, {MEAN} ({UNIT})": ("2770", "106.34"),
    f"Effort, {ROBUST} ({UNIT})": ("3530", "112.12"),
    f"Effort, {LEAST} ({UNIT})": ("5910", "200.4"),
    f"Effort, {ROBUST}, over the first": ("1.27", "1.054"),
    f"Effort, {LEAST}, over the first": ("2.13", "1.885"),
    f"σ of the tip's x and y at the end, {ROBUST} (m)": ("0.191 and 0.133", "–"),
    f"σ of the tip's x and y at the end, {LEAST} (m)": ("0.144 and 0.114", "–"),
    f"Norm of the tip's variances, {LEAST} (m²)": ("–", "0.02533"),
}
"""Values of the dissertation, and of an independent program for the same arm."""

TITLE = "Pick and place with minimum effort: forward dynamics"
SUBTITLE = (
    f"Two-link arm, payload in kg: {effort.PAYLOAD}; {given(effort.DURATION)} s, torques within ±{given(TORQUE)} N m;"
    " dissertation, section 5.5.1"
)
GLOSSARY = (
    ("Deterministic plan", "The minimum effort that brings the mean payload to its target (72)."),
    ("Robust plan", "The same in the mean, with one σ of clearance from obstacle and wall, (79) and (90)."),
    ("Least variance", "Under the same limits, the minimum norm of the tip's variances at the end (86)."),
    ("Effort", f"∫ τ₁² + τ₂² dt, {UNIT}."),
    ("Forward dynamics", "The torques act as planned, open loop; the payload changes where the arm goes."),
)
LEFT_OUT = "the plan of least variance, and a wider payload"
LESSON = (
    "The dissertation's payload has a standard deviation of 0.5 kg. The same torques then send a light and a heavy "
    "payload to quite different places, and the joint angles as functions of the payload are too strongly curved "
    "for a polynomial of order 5. The remedy is feedback, or planning the motion instead of the torques: see the "
    "study pick-and-place-time."
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

    page.section("The system", arm_schematic(page, effort.PAYLOAD))

    page.section("The plans")
    # Deterministic from bent paths; the others from the plan before them, and from these paths as well.
    bent = [{}, *({"torque.free": effort.start_torques(bend)} for bend in BENDS)][:starts]
    searches = dict[str, al.results.Starts]()
    for name, problem in page.study.problems.items():
        if not (quick and name == LEAST):
            earlier = [dict(one.best.decisions) for one in searches.values()][-1:]
            searches[name] = shared.search(page, name, problem, [*earlier, *bent[len(earlier) :]])
    tried = effort.robust_problem(shared.TRIED, guess=searches[ROBUST].best.decisions["torque.free"])
    margin = shared.calibrated(page, tried, ["obstacle", "wall"], trial)
    plans = shared.judged(page, searches, margin, samples, systems)
    families, robust = plans.families, plans.solutions[ROBUST]
    page.recommend(
        shared.to_build(
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
                f"At the end the tip has σ = {spread(families[shared.CALIBRATED])} m in x and y, which clearance does "
                "not reduce, and no open-loop plan brings to zero: feedback has to do the rest.",
            ],
        )
    )
    page.add(reporting.designs_table(plans.solutions, plans.evidence), printed=True)

    page.section("Comparison with published values", compared(plans), printed=True)
    ARM.show(page, plans, (MEAN, ROBUST), {MEAN: ("", "5.2"), ROBUST: ("", "5.3"), LEAST: ("", "5.4")})

    if not quick:
        page.section("How wide a payload")
        wide = effort.robust_problem(payload=WIDE)
        error = kept("error of the expansion", error_at_end, wide, robust.vector)
        thrown = shared.flown(f"payload {WIDE}", robust, systems, wide)
        told = f"Here it misses {percent(error)} of the spread of the first joint at the end."
        figures = [ARM.histories(thrown)[0], ARM.paths(plans, ROBUST, thrown)]
        page.add(
            Text([LESSON, told], lead="No single open-loop plan suits widely spread payloads."),
            Drawing(figures, f"The robust plan with payload {WIDE}", shared.SHADES),
        )

    page.section("How wide a margin", shared.margin_drawing(margin, "payloads"))
    shared.add_trust(page, plans.solutions, searches)


def error_at_end(problem: al.Problem, decisions: Float[np.ndarray, " n"]) -> float:
    """The leave-one-out error of the first joint's final angle by the expansion."""
    return float(transcribe(problem).resolve(decisions)["q1(t_f)"].leave_one_out)


def effort_of(plan: al.Solution) -> float:
    """`∫ τ₁² + τ₂² dt` of a plan, (N m)² s: its objective, or what it limits."""
    return next((limit.worst for limit in plan.constraints if limit.name == "effort"), plan.objective)


def spread(family: al.results.Motions) -> str:
    """The standard deviations of the tip's final position, x and y, m: `0.191 and 0.133`."""
    return " and ".join(number(float(family.moments[output].std[-1]), 3) for output in effort.TIP)


def compared(plans: shared.Plans) -> Table:
    """Published values and those of an independent program, compared with ours."""
    efforts = {name: effort_of(plan) for name, plan in plans.solutions.items()}
    ours = {f"Effort, {name} ({UNIT})": number(one, 5) for name, one in efforts.items()}
    for name, one in efforts.items():
        if name != MEAN:
            ours[f"Effort, {name}, over the first"] = number(one / efforts[MEAN], 4)
            ours[f"σ of the tip's x and y at the end, {name} (m)"] = spread(plans.families[name])
    if LEAST in plans.solutions:
        ours[f"Norm of the tip's variances, {LEAST} (m²)"] = number(plans.solutions[LEAST].objective, 4)
    note = (
        "Reference: an independent program for the same arm, with limits only at the 61 instants; ours hold between "
        "them too. The published efforts are sums over an unstated number of samples, for another inertia model, "
        "another obstacle and a payload with a standard deviation of 0.5 kg."
    )
    return shared.comparison(("Published", "Reference", "Ours"), PUBLISHED, ours, note)
