"""The study of pick and place in minimum time: three plans, the margin for tolerated violations, which to build."""

import numpy as np

import aleator as al
from aleator import reporting
from aleator.reporting import Text, given, number, percent, share_text
from aleator.studies import _shared as shared
from aleator.studies._study import Draft
from aleator.studies.pick_and_place_time import PAYLOAD, deterministic_problem, robust_problem
from aleator.studies.two_link_arm import TORQUE
from aleator.studies.two_link_arm._views import ARM, arm_schematic

MEAN, ONE, WORST = "deterministic", "robust, a = 1", "robust, a = √3"
MARGINS = {ONE: 1.0, WORST: float(np.sqrt(3.0))}
REFERENCE = {MEAN: 1.4142, ONE: 1.5938}
"""Durations by an independent program for the same arm, s."""
PUBLISHED = {
    f"t_f, {MEAN} (s)": ("1.12", f"{REFERENCE[MEAN]}"),
    f"t_f, {ONE} (s)": ("1.20", f"{REFERENCE[ONE]}"),
    f"t_f, {ONE}, over the first": ("1.07", "1.127"),
}
"""Values of the dissertation, and of the independent program."""

TITLE = "Pick and place in minimum time: inverse dynamics"
SUBTITLE = (
    f"Two-link arm, payload in kg: {PAYLOAD}; torques within ±{given(TORQUE)} N m; dissertation, sections 5.5.2 and 5.6"
)
GLOSSARY = (
    ("Deterministic plan", "The fastest plan for the mean payload (73)."),
    ("Robust plan", "The fastest plan whose torques keep their limits with μ ± a·σ, (80) and (91)."),
    ("Inverse dynamics", "The joints follow the plan exactly; the payload changes the torques needed."),
    ("t_f", "Duration of the motion, chosen by the plan."),
)
LEFT_OUT = "most starts of the searches"
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

    page.section("The system", arm_schematic(page, PAYLOAD))

    page.section("The plans")
    # The first from random starts, the robust ones from the optima before them too.
    searches = {MEAN: shared.search(page, MEAN, page.study.problems[MEAN], starts)}
    for name, sigmas in MARGINS.items():
        earlier = [dict(one.decisions) for each in searches.values() for one, _ in each.optima[:4]]
        last = list(searches.values())[-1].best.decisions["motion.free"]
        searches[name] = shared.search(page, name, robust_problem(sigmas, guess=last), earlier)
    tried = robust_problem(shared.TRIED, guess=searches[ONE].best.decisions["motion.free"])
    margin = shared.calibrated(page, tried, ["torque"], trial)
    plans = shared.judged(page, searches, margin, samples, systems)
    durations = {name: plan.objective for name, plan in plans.solutions.items()}
    page.recommend(
        reporting.recommendation(
            plans.solutions[WORST],
            plans.evidence[WORST],
            labels={"t_final": "a motion of", "motion.free": "both joints' splines of"},
            nominal=plans.solutions[ONE],
            compared={"with the printed margin": plans.evidence[ONE]},
            target=shared.TARGET,
            who="payloads",
            objective="duration",
            change=("longer", "shorter"),
            not_verified=["the inertias and the obstacle of the dissertation, which are not published"],
            sentences=[
                f"The published margin of one σ is not safe: {share_text(plans.evidence[ONE].joint)} of the payloads "
                f"overload a joint. This agrees with theory: {percent(1 - 1 / np.sqrt(3))} of uniform payloads lie "
                "outside μ ± σ.",
                f"If {given(100 * margin.target)} % of the payloads may fail, a = {number(margin.sigmas, 4)} saves "
                f"{number(1000 * (durations[WORST] - durations[shared.CALIBRATED]), 2, 'ms')}.",
            ],
        )
    )
    page.add(reporting.designs_table(plans.solutions, plans.evidence), printed=True)

    ours = {f"t_f, {name} (s)": number(one, 5) for name, one in durations.items()}
    ours[f"t_f, {ONE}, over the first"] = number(durations[ONE] / durations[MEAN], 4)
    note = (
        "Reference: an independent program for the same arm, with limits only at the 91 instants; ours hold between "
        "them too. The published times cannot be reproduced: the dissertation gives neither the inertias nor the "
        "obstacle, and no arm whose parameters are all one has both of its times."
    )
    table = shared.comparison(("Published", "Reference", "Ours"), PUBLISHED, ours, note)
    page.section("Comparison with published values", table, printed=True)
    ARM.show(page, plans, (MEAN, WORST), {MEAN: ("5.5", ""), ONE: ("5.6", ""), WORST: ("5.6", "5.7")})

    why = Text(WHY, lead="Why one σ excludes four payloads in ten.")
    page.section("How wide a margin", why, shared.margin_drawing(margin, "payloads"))
    shared.add_trust(page, plans.solutions, searches)
