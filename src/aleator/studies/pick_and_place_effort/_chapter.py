"""The study of pick and place with minimum effort: its plans, the front between two of them, and a wider payload."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import scipy
from jaxtyping import Float

import aleator as al
from aleator.journalling import kept
from aleator.reporting import (
    Drawing,
    Table,
    Text,
    designs_table,
    front_figure,
    given,
    linked_front,
    number,
    percent,
    share_text,
)
from aleator.studies._motion import (
    CALIBRATED,
    SHADES,
    TRIED,
    add_trust,
    calibrated,
    compared,
    counted,
    flown,
    held_at_instants,
    search,
    to_build,
    torques_figure,
)
from aleator.studies._shared import margin_drawing
from aleator.studies._study import Draft
from aleator.studies.pick_and_place_effort import (
    DURATION,
    PAYLOAD,
    TOLERANCE,
    deterministic_problem,
    robust_problem,
    start_torques,
    terminal_variance_problem,
)
from aleator.studies.two_link_arm import TORQUE
from aleator.studies.two_link_arm._views import ARM, TORQUES, arm_schematic, touches
from aleator.transcription import transcribe

MEAN, ROBUST, LEAST = "deterministic", "robust", "least variance"
NAMES = (MEAN, ROBUST, LEAST, CALIBRATED)
UNIT = "(N m)² s"
WIDE = al.Uniform(1.0, std=0.5)
"""A payload with five times the spread."""
BENDS = (1.2, 0.6, 2.5)
"""The bend of the elbow on the paths from which searches start, besides the problem's own, rad."""
MOST = 2 * TORQUE**2 * DURATION
"""The effort of both torques at their limits throughout: no plan takes more."""

PUBLISHED = {MEAN: 2770.0, ROBUST: 3530.0, LEAST: 5910.0}
PUBLISHED_SPREADS = {MEAN: "–", ROBUST: "0.191 and 0.133", LEAST: "0.144 and 0.114"}
"""Efforts in the dissertation, and σ of the tip's x and y at the end, m."""
REFERENCE = {MEAN: 106.34, ROBUST: 112.12, LEAST: 200.4}
REFERENCE_NORM = 0.02533
"""Efforts by an independent program for the same arm, and its smallest norm of the tip's variances, m²."""

TITLE = "Pick and place with minimum effort: forward dynamics"
SUBTITLE = (
    f"Two-link arm, payload in kg: {PAYLOAD}; {given(DURATION)} s, torques within ±{given(TORQUE)} N m;"
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
    ("μ, σ", "Mean and standard deviation over all payloads."),
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
    return {MEAN: deterministic_problem(), ROBUST: robust_problem(), LEAST: terminal_variance_problem(MOST)}


def chapter(page: Draft, quick: bool) -> None:
    """Section 5.5.1, and the margin to build with, which it leaves open."""
    starts, samples, systems, trial = (1, 2_000, 400, 2_000) if quick else (4, 20_000, 2_000, 10_000)

    page.section("The system")
    page.add(arm_schematic(PAYLOAD, page.study.problems))

    page.section("The plans")
    # Deterministic from bent paths; the others from the plan before them, and from these paths as well.
    bent = [{}, *({"torque.free": start_torques(bend)} for bend in BENDS)][:starts]
    searches, plans = dict[str, al.results.Starts](), dict[str, al.Solution]()
    for name, problem in page.study.problems.items():
        if not (quick and name == LEAST):
            earlier = [dict(one.decisions) for one in plans.values()][-1:]
            searches[name] = search(page, name, problem, [*earlier, *bent[len(earlier) :]])
            plans[name] = searches[name].best
    margin = calibrated(page, margin_problem(plans[ROBUST]), ["obstacle", "wall"], trial)
    plans[CALIBRATED] = margin.solution
    evidence = counted(page, plans, samples, margin)
    families = {name: flown(name, plan, systems) for name, plan in plans.items()}
    page.recommend(
        to_build(
            margin,
            plans[ROBUST],
            evidence[ROBUST],
            labels={"torque.free": "both torques as splines of"},
            who="payloads",
            objective="effort",
            not_verified=["the inertias and the obstacle of the dissertation, which are not published"],
            sentences=[*sentences(evidence, families)],
        )
    )
    page.add(designs_table(plans, evidence), printed=True)

    page.section("Comparison with published values")
    coarse = {} if quick else held_at_instants(page, plans, (MEAN, ROBUST))
    page.add(published_table(plans, coarse, families), printed=True)

    page.section("The motion")
    page.add(
        ARM.animation({name: families[name] for name in (MEAN, ROBUST)}, NAMES),
        Drawing(
            [ARM.paths(name, one, touches(one), NAMES) for name, one in families.items()],
            "Path of the tip",
            "With another payload, the same torques lead elsewhere. Arms that touch obstacle or wall, with either "
            "link, are highlighted.",
        ),
    )

    page.section("Where the arm goes")
    for name, figure in ((MEAN, "5.2"), (ROBUST, "5.3"), (LEAST, "5.4")):
        if name in families:
            histories, heading = ARM.histories(families[name]), f"{name.capitalize()} plan on its family"
            page.add(Drawing(histories, heading, f"Rings: the target. {SHADES}", figure))
    torques = [torques_figure(one, TORQUES, TORQUE, name.capitalize()) for name, one in families.items()]
    page.add(Drawing(torques, "Torques", "They act as planned on every arm, and so have no spread."))

    if not quick:
        page.section("Effort against spread")
        bare = terminal_variance_problem(MOST, guess=plans[LEAST].decisions["torque.free"])
        # From where more effort brings no gain down to that of the robust plan.
        efforts = np.linspace(effort(families[LEAST]), 1.01 * plans[ROBUST].objective, 7)
        front = al.pareto(bare, "effort", efforts, progress=page.progress)
        page.keep("front", front)
        fronts = {LEAST: front}
        figure = front_figure(fronts, x="Effort allowed", x_unit=UNIT, y="Norm of the tip's variances", y_unit="m²")
        told = "Each point is the plan with the smallest spread of the tip for its effort. The first increases beyond "
        told += "the robust plan's effort gain most; at the right end the torques are at their limits wherever that "
        page.add(linked_front(fronts, [figure], "The cost of a smaller spread", f"{told}helps."))

        page.section("How wide a payload")
        wide = robust_problem(payload=WIDE)
        thrown = flown(f"payload {WIDE}", plans[ROBUST], systems, wide)
        page.add(
            Text(LESSON, lead="No single open-loop plan suits widely spread payloads."),
            spreads_table(plans[ROBUST], [(PAYLOAD, families[ROBUST]), (WIDE, thrown)]),
            Drawing(
                [ARM.histories(thrown)[0], ARM.paths(ROBUST, thrown, touches(thrown), NAMES)],
                f"The robust plan with payload {WIDE}",
                SHADES,
            ),
        )

    page.section("How wide a margin")
    page.add(margin_drawing(margin, "The margin for a tolerated share of violations", "payloads"))

    add_trust(page, searches, plans)


def margin_problem(plan: al.Solution) -> al.Problem:
    """The problem of least effort whose margin is calibrated, to be solved from a plan."""
    return robust_problem(TRIED, guess=plan.decisions["torque.free"])


def effort(family: al.results.Motions) -> float:
    """`∫ τ₁² + τ₂² dt` of a plan, (N m)² s, by Simpson's rule on its instants; the torques of all arms are the same."""
    squares = sum(family.systems[name][0] ** 2 for name in TORQUES.values())
    return float(scipy.integrate.simpson(squares, x=family.times))


def terminal_spread(family: al.results.Motions) -> str:
    """The standard deviations of the tip's final position, x and y, m: `0.191 and 0.133`."""
    return " and ".join(number(float(family.moments[name].std[-1]), 3) for name in ("tip_x", "tip_y"))


def sentences(evidence: Mapping[str, al.results.Evidence], families: Mapping[str, al.results.Motions]) -> Iterator[str]:
    """Why the published clearance is not enough, and what no clearance can do."""
    mean, robust = (share_text(evidence[name].violations["obstacle"]) for name in (MEAN, ROBUST))
    yield (
        f"The deterministic plan grazes the obstacle with the mean payload, so that {mean} of all payloads hit it. "
        f"With one σ of clearance, as published, {robust} hit it: for a uniform distribution 21.1 % of the payloads "
        "lie beyond one σ on one side."
    )
    yield (
        f"At the end the tip has σ = {terminal_spread(families[CALIBRATED])} m in x and y, which clearance does not "
        "reduce: feedback has to do the rest."
    )
    if LEAST in families:
        yield (
            f"The best that torques can achieve, with {number(effort(families[LEAST]) / effort(families[ROBUST]), 3)} "
            f"times the effort, is σ = {terminal_spread(families[LEAST])} m: no open-loop plan brings it to zero."
        )


def published_table(
    plans: Mapping[str, al.Solution],
    coarse: Mapping[str, al.Solution],
    families: Mapping[str, al.results.Motions],
) -> Table:
    """Published values and those of an independent program, compared with ours."""
    shown = [name for name in PUBLISHED if name in plans]
    ours = {name: effort(families[name]) for name in shown}
    texts = {
        "Effort over that of the first, published": [number(PUBLISHED[name] / PUBLISHED[MEAN], 3) for name in shown],
        "– ours": [number(ours[name] / ours[MEAN], 3) for name in shown],
        f"Effort, {UNIT}, reference": [number(REFERENCE[name], 5) for name in shown],
        "– ours, with limits at the instants": [
            number(coarse[name].objective, 5) if name in coarse else "–" for name in shown
        ],
        "– ours, between the instants too": [number(ours[name], 5) for name in shown],
        "Norm of the tip's variances, m², reference": [
            number(REFERENCE_NORM, 4) if name == LEAST else "–" for name in shown
        ],
        "– ours, norm": [number(plans[name].objective, 4) if name == LEAST else "–" for name in shown],
        "σ of the tip's x and y at the end, m, published": [PUBLISHED_SPREADS[name] for name in shown],
        "– ours, σ": [terminal_spread(families[name]) for name in shown],
    }
    note = (
        "Reference: an independent program for the same arm, with limits only at the 61 instants. The published "
        "efforts are sums over an unstated number of samples, for another inertia model, another obstacle and a "
        f"payload with a standard deviation of 0.5 kg. {compared(PUBLISHED, ours, 'the efforts')}"
    )
    rows = [[text, *cells] for text, cells in texts.items()]
    return Table("Published and reference values compared with ours", ["", *shown], rows, note)


def spreads_table(plan: al.Solution, families: Sequence[tuple[al.Uniform, al.results.Motions]]) -> Table:
    """The joints' standard deviations at the end by payload: sampled, and by the expansion with its error."""
    rows = []
    for payload, family in families:
        problem = robust_problem(payload=payload)
        for name, (spread, error) in kept(f"expansion, payload {payload}", ends, problem, plan.vector).items():
            spreads = number(float(family.moments[name].std[-1]), 3), number(spread, 3)
            rows.append([f"{name}(t_f), {payload}", *spreads, percent(error)])
    header = ["", "σ sampled (rad)", "σ by order 5 (rad)", "Leave-one-out error"]
    note = (
        f"Above {given(100 * TOLERANCE)} % an output counts as unresolved: a solve warns, and means and standard "
        "deviations are not to be trusted."
    )
    return Table("The robust plan with the payload of this study and with a wider one", header, rows, note)


def ends(problem: al.Problem, decisions: Float[np.ndarray, " n"]) -> dict[str, tuple[float, float]]:
    """The standard deviation of each joint's final angle by the expansion, rad, and its leave-one-out error."""
    resolved = transcribe(problem).resolve(decisions)
    each = {name: resolved[f"{name}(t_f)"] for name in ("q1", "q2")}
    return {name: (float(one.std), float(one.leave_one_out)) for name, one in each.items()}
