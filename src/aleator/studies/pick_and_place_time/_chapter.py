"""The study of pick and place in minimum time: three plans, the margin for tolerated violations, which to build."""

from collections.abc import Iterator, Mapping

import numpy as np
import scipy

import aleator as al
from aleator.reporting import (
    Drawing,
    Table,
    Text,
    designs_table,
    given,
    number,
    percent,
    recommendation,
    share_text,
)
from aleator.studies._motion import (
    CALIBRATED,
    SHADES,
    TARGET,
    TRIED,
    add_trust,
    calibrated,
    compared,
    counted,
    duration,
    flown,
    held_at_instants,
    search,
    torques_figure,
)
from aleator.studies._shared import margin_drawing
from aleator.studies._study import Draft
from aleator.studies.pick_and_place_time import PAYLOAD, deterministic_problem, robust_problem
from aleator.studies.two_link_arm import TORQUE
from aleator.studies.two_link_arm._views import ARM, TORQUES, arm_schematic

MEAN, ONE, WORST = "deterministic", "robust, a = 1", "robust, a = √3"
MARGINS = {ONE: 1.0, WORST: float(np.sqrt(3.0))}
NAMES = (MEAN, ONE, WORST, CALIBRATED)
PUBLISHED = {MEAN: 1.12, ONE: 1.20}
"""Durations in the dissertation, s."""
REFERENCE = {MEAN: 1.4142, ONE: 1.5938}
"""Those of an independent program for the same arm, s."""

TITLE = "Pick and place in minimum time: inverse dynamics"
SUBTITLE = (
    f"Two-link arm, payload in kg: {PAYLOAD}; torques within ±{given(TORQUE)} N m; dissertation, sections 5.5.2 and 5.6"
)
GLOSSARY = (
    ("Deterministic plan", "The fastest plan for the mean payload (73)."),
    ("Robust plan", "The fastest plan whose torques keep their limits with μ ± a·σ, (80) and (91)."),
    ("μ, σ", "Mean and standard deviation over all payloads."),
    ("Margin a", "The number of σ kept between the mean torque and its limit."),
    ("Inverse dynamics", "The joints follow the plan exactly; the payload changes the torques needed."),
    ("t_f", "Duration of the motion, chosen by the plan."),
)
LEFT_OUT = "most starts of the searches, and plans with limits at the instants alone"
WHY = (
    (
        "Along a given motion each torque is affine in the payload: τ = τ₀(t) + τ₁(t)·M. So it is uniformly "
        "distributed like the payload, its skewness is zero, and μ ± σ covers 1/√3 = 57.7 % of the payloads at every "
        "instant. Where both heavier and lighter payloads reach a limit, 1 − 1/√3 = 42.3 % overload a joint."
    ),
    (
        "For one uniform payload a = √3 is the exact worst case. For other distributions, or several uncertain "
        "numbers, the share outside a margin is not known beforehand: count it and calibrate a, as below (section 5.6)."
    ),
)


def problems() -> dict[str, al.Problem]:
    """The problems of the plans, each with its own start."""
    return {MEAN: deterministic_problem(), **{name: robust_problem(sigmas) for name, sigmas in MARGINS.items()}}


def chapter(page: Draft, quick: bool) -> None:
    """Section 5.5.2, and the margin of section 5.6."""
    starts, samples, systems, trial = (3, 4_000, 400, 2_000) if quick else (16, 20_000, 2_000, 10_000)

    page.section("The system")
    page.add(arm_schematic(PAYLOAD, page.study.problems))

    page.section("The plans")
    # The first from random starts, the robust ones from the optima before them too.
    searches = {MEAN: search(page, MEAN, page.study.problems[MEAN], starts)}
    for name, sigmas in MARGINS.items():
        earlier = [dict(one.decisions) for each in searches.values() for one, _ in each.optima[:4]]
        searches[name] = search(page, name, from_plan(sigmas, list(searches.values())[-1].best), earlier)
    plans = {name: one.best for name, one in searches.items()}
    margin = calibrated(page, from_plan(TRIED, plans[ONE]), ["torque"], trial)
    plans[CALIBRATED] = margin.solution
    evidence = counted(page, plans, samples, margin)
    page.recommend(
        recommendation(
            plans[WORST],
            evidence[WORST],
            labels={"t_final": "a motion of", "motion.free": "both joints' splines of"},
            nominal=plans[ONE],
            compared={"with the printed margin": evidence[ONE]},
            target=TARGET,
            who="payloads",
            objective="duration",
            change=("longer", "shorter"),
            not_verified=["the inertias and the obstacle of the dissertation, which are not published"],
            sentences=[*sentences(plans, evidence, margin)],
        )
    )
    page.add(designs_table(plans, evidence), printed=True)

    page.section("Comparison with published values")
    coarse = {} if quick else held_at_instants(page, plans, REFERENCE)
    page.add(published_table(plans, coarse), printed=True)

    page.section("Torques against their limits")
    families = {name: flown(name, plan, systems) for name, plan in plans.items()}
    mean = plans[MEAN].outputs
    page.add(
        Drawing(
            [
                torques_figure(mean, TORQUES, TORQUE, "The mean payload"),
                torques_figure(families[MEAN], TORQUES, TORQUE, "All payloads"),
            ],
            "Torques of the deterministic plan",
            "The fastest plan keeps one torque or the other at its limit almost throughout. Another payload on the "
            f"same path needs more. {SHADES}",
            "5.5",
        ),
        Drawing(
            [torques_figure(families[name], TORQUES, TORQUE, name.capitalize()) for name in MARGINS],
            "Torques of the robust plans",
            "The margin moves the bands inside the limits: with a = 1 the dark band of one σ, with a = √3 the light "
            "band of all payloads, since a uniform distribution ends √3 σ from its mean.",
            "5.6",
        ),
    )

    page.section("The motion")
    page.add(
        ARM.animation({name: families[name] for name in (MEAN, WORST)}, NAMES),
        Drawing(
            ARM.histories(families[WORST])[:1],
            "Configuration over time",
            "The joints follow the plan whatever the payload, and so have no spread.",
            "5.7",
        ),
    )

    page.section("How wide a margin")
    page.add(
        Text(WHY, lead="Why one σ excludes four payloads in ten."),
        margins_table(evidence, families),
        margin_drawing(margin, "The margin for a tolerated share of violations", "payloads"),
    )

    add_trust(page, searches, plans)


def from_plan(sigmas: float, plan: al.Solution) -> al.Problem:
    """The problem of a robust plan, to be solved from another plan."""
    return robust_problem(sigmas, guess=plan.decisions["motion.free"])


def predicted_share(sigmas: float) -> float:
    """The share of payloads more than `sigmas` standard deviations from the mean: `1 - a/√3` if uniform."""
    return max(0.0, 1.0 - sigmas / np.sqrt(3.0))


def sentences(
    plans: Mapping[str, al.Solution],
    evidence: Mapping[str, al.results.Evidence],
    margin: al.results.Calibration,
) -> Iterator[str]:
    """How often the other plans fail, and the time that tolerated violations save."""
    yield (
        "Do not run the plan for the mean payload: it drives the torques to their limits, and "
        f"{share_text(evidence[MEAN].joint)} of the payloads need more."
    )
    yield (
        f"The published margin of one σ is not safe: {share_text(evidence[ONE].joint)} of the payloads overload a "
        f"joint. This agrees with theory: {percent(predicted_share(1.0))} of uniform payloads lie outside μ ± σ."
    )
    less = duration(plans[WORST]) - duration(margin.solution)
    yield (
        f"If {given(100 * margin.target)} % of the payloads may fail, a = {number(margin.sigmas, 4)} saves "
        f"{number(1000 * less, 2, 'ms')}: it is {margin.sentence('payloads')}."
    )


def margins_table(evidence: Mapping[str, al.results.Evidence], families: Mapping[str, al.results.Motions]) -> Table:
    """The share of payloads outside a margin: in closed form, and counted."""
    rows = []
    for name, sigmas in MARGINS.items():
        skewness = [scipy.stats.skew(families[name].systems[torque], axis=0) for torque in TORQUES.values()]
        shares = percent(predicted_share(sigmas)), share_text(evidence[name].violations["torque"])
        rows.append([name, *shares, number(float(np.nanmax(np.abs(skewness))), 2)])
    error = float(np.sqrt(6 / len(families[ONE].systems["q1_torque"])))
    header = ["Plan", "Payloads outside μ ± a·σ", "Payloads that overload a joint", "Largest skewness of a torque"]
    note = (
        "Skewness is that of the sampled torques at the instant where it is largest; its sampling error is "
        f"{number(error, 2)}."
    )
    return Table("The effect of a margin", header, rows, note)


def published_table(plans: Mapping[str, al.Solution], coarse: Mapping[str, al.Solution]) -> Table:
    """Published durations and those of an independent program, compared with ours."""
    ours = {name: duration(plan) for name, plan in plans.items()}
    rows = [
        [
            name,
            given(PUBLISHED[name], "s"),
            f"{REFERENCE[name]:.4f} s",
            number(duration(coarse[name]), 5, "s") if coarse else "–",
            number(ours[name], 5, "s"),
        ]
        for name in PUBLISHED
    ]
    note = (
        "Reference: an independent program for the same arm, with limits only at the 91 instants. The published "
        "times cannot be reproduced: the dissertation gives neither the inertias nor the obstacle, and no arm "
        f"whose parameters are all one has both of its times. {compared(PUBLISHED, ours, 'the published times')}"
    )
    header = ["t_f", "Published", "Reference", "Ours, at the instants", "Ours, between them too"]
    return Table("Published and reference values compared with ours", header, rows, note)
