"""The suspension study: three designs of a quarter car, how often their cars exceed limits, and which one to build."""

from collections.abc import Mapping
from typing import Any

import numpy as np

import aleator as al
from aleator import reporting
from aleator.reporting import Drawing, Linked, count, given
from aleator.studies import suspension
from aleator.studies._shared import add_second_way, gathered, margin_drawing, sampled, system
from aleator.studies._study import Draft
from aleator.studies.suspension import _views as views
from aleator.studies.suspension import apportionment_problem, deterministic_problem, robust_problem
from aleator.studies.suspension._figures import shaded
from aleator.studies.suspension._views import HOLDING, NARROW, RIDE, RIDE_UNIT, TRAVEL, cost

TARGET = 0.01
MARGIN, RIDE_MARGIN = 1.6, 2.4
"""The initial margins of the search for those to build with, of travel and holding, and of ride. Their ratio is kept.

Equation (119) adds the standard deviations of both masses, more than that of their distance, and ride is skewed
upwards; so ride needs a larger multiple of σ for the same share. With one margin for all, no spreads keep the limits in
99 of 100 cars; of the ratios between 1.3 and 1.7, this one has the lowest cost, to a tenth.
"""

TITLE = "Suspension of a quarter car: robust design and apportioned spreads"
SUBTITLE = (
    f"Travel within ±{TRAVEL:g} m, holding at most {HOLDING:g} m; ride at most {RIDE:g} m²/s³ where the spreads are "
    "chosen too; five uncertain parameters; dissertation, sections 6.4 and 7.4"
)
GLOSSARY = (
    ("dOpt", "Deterministic optimum: the nominal spring and damper with the best ride for the nominal car only."),
    ("uOpt", "Robust optimum: the same two decisions, for all cars that the uncertainty allows."),
    ("aOpt", "Apportioned optimum: the means and the manufacturing spreads are chosen together at minimum cost."),
    ("Ride", "Integral of the squared acceleration of the passenger, m²/s³. Smaller is more comfortable."),
    ("Travel (rattle), R", "Distance between body and wheel from rest, m; limited to ±R at every instant."),
    ("Holding, H", "Root mean square of the tyre's deflection, m; at most H. Smaller keeps the wheel on the ground."),
    ("Half-width", "A uniform distribution extends from the mean minus to the mean plus its half-width."),
    ("95 % interval", "Clopper and Pearson: encloses the true share of cars in at least 95 of 100 such countings."),
)
LEFT_OUT = "the margins to build with, and the check by direct collocation"
STATES = 4 * 5601
"""The states of the nominal car at the points of its mesh: in the second way this one car takes seconds."""


def problems() -> dict[str, al.Problem]:
    """The problems of the three designs."""
    return {
        "dOpt": deterministic_problem(TRAVEL, HOLDING),
        "uOpt": robust_problem(TRAVEL, HOLDING),
        "aOpt": apportionment_problem(TRAVEL, HOLDING, RIDE),
    }


def chapter(page: Draft, quick: bool) -> None:
    """Both chapters of the dissertation, and the margins to build with, which it leaves open."""
    samples, points = (4_000, 4) if quick else (100_000, 11)

    page.section("The car")
    told = (
        "The size of boxes shows their masses; the road is that of the model. ± is the half-width of a uniform "
        "distribution; means that a design chooses have the index 0. The damper is η times as strong in compression as "
        "in extension."
    )
    page.add(system(page, "suspension/car.svg", "Quarter car on its road", told, "6.1 and 6.3"))
    heights = np.asarray(suspension.road().values)
    figure = reporting.histories_figure(np.asarray(suspension.GRID.times), heights[None], y="Road height", unit="m")
    figure.update_layout(showlegend=False, height=300)
    page.add(Drawing([figure], "The road", "Four bumps of 0.15 m at 1, 5, 10 and 15 Hz, with noise on top.", "6.2"))

    page.section("The three designs")
    designs = gathered(page, "designs", al.solve, page.study.problems)
    evidence = sampled(page, designs, samples)
    page.add(views.designs_table("Decisions, performance and violations", designs, evidence), printed=True)
    told = (
        "Points are means, boxes extend one σ to each side. dOpt has no spread, and lies on the holding limit. The box "
        "of uOpt ends at the travel limit, so its mean had to move inward. aOpt has the largest box: its spreads grow "
        "until they meet the ride and travel limits."
    )
    page.add(views.projections(designs, "The designs among their limits", "7.2", told))

    built = {} if quick else build(page, designs, evidence)
    page.recommend(recommended(designs, evidence, built))
    chosen = designs | {name: one.solution for name, one in built.items()}

    page.section("How often cars exceed a narrow travel")
    problems = {
        "dOpt": deterministic_problem(NARROW, HOLDING),
        "uOpt, 1 σ": robust_problem(NARROW, HOLDING, 1.0),
        "uOpt, 1.25 σ": robust_problem(NARROW, HOLDING, 1.25),
    }
    lessons = {
        "6.9": "The deterministic design: best for the nominal car, without reserve for the others.",
        "6.10 a": "The robust design with a margin of 1 σ: a narrow bundle, with few cars outside.",
        "6.10 b": "With a slightly larger margin, a = 1.25, violations become rare.",
    }
    narrow = gathered(page, "narrow", al.solve, problems)
    few = min(samples, 20_000)  # shares of a tenth, to half a percent
    narrow_evidence = sampled(page, narrow, few, "narrow_evidence")
    for name, (number, lesson) in zip(narrow, lessons.items(), strict=True):
        figure = reporting.trajectory_figure(narrow_evidence[name], "travel", y="Travel", unit="m", who="cars")
        told = f"{lesson} Counted on {count(few)} cars."
        page.add(Drawing([figure], f"{name}, travel within ±{NARROW:g} m", told, number))
    if not quick:
        exact = al.calibrate(robust_problem(NARROW, HOLDING), "travel", TARGET, samples=20_000, progress=page.progress)
        page.keep("calibration", exact)
        page.add(margin("The margin that meets the target for violations", exact))

    def front(fronts: Mapping[str, al.results.Front], heading: str, told: str, number: str, **axes: Any) -> Linked:
        shown = list(evidence.values()), chosen[list(fronts)[-1]]
        figures = [reporting.front_figure(fronts, **axes)]
        told = f"Filled markers: the swept limit is active; open markers: another limit is. {told}"
        return reporting.linked_front(fronts, figures, heading, told, number, *shown)

    page.section("Trade-offs of ride")
    nominal_and_robust = {"dOpt": deterministic_problem(), "uOpt": robust_problem()}
    over_travel = swept(page, "travel_fronts", nominal_and_robust, "travel", np.linspace(0.25, 0.145, points))
    told = (
        "Accounting for uncertainty shifts the whole trade-off up; where the curves are flat, holding is active and "
        "more travel brings no gain."
    )
    ride: dict[str, Any] = {"y": "Ride ∫ z̈ₛ² dt, μ + σ", "y_unit": RIDE_UNIT}
    over_r = {"x": "Travel limit R", "x_unit": "m"}
    page.add(
        front(over_travel, f"Ride against the travel limit, H = {HOLDING:g} m", told, "6.4", **over_r, **ride),
        views.shadow_price(over_travel, "centimetre of travel", 0.01, "cm", **over_r),
    )
    over_holding = swept(page, "holding_fronts", nominal_and_robust, "holding", np.linspace(0.0365, 0.0280, points))
    told = (
        "The robust design changes its active limit first, because its box meets the travel limit earlier (figure "
        "6.7). Crosses: no design meets all limits."
    )
    over_h = {"x": "Holding limit H", "x_unit": "m"}
    page.add(
        front(over_holding, f"Ride against the holding limit, R = {TRAVEL:g} m", told, "6.5", **over_h, **ride),
        views.shadow_price(over_holding, "millimetre of holding", 0.001, "mm", **over_h),
        views.projections(
            {name: designs[name] for name in ("dOpt", "uOpt")},
            "Why uncertainty changes the active limit",
            "6.6",
            "With the same limits, different ones are active: dOpt lies on the holding limit; uOpt's box touches the "
            "travel limit, which keeps its mean away from both.",
        ),
        views.holding_boxes(over_holding),
        views.decision_path(over_holding),
    )

    page.section("Apportioned spreads")
    costs = swept(
        page, "travel_fronts", {"aOpt": apportionment_problem(ride=RIDE)}, "travel", over_travel["uOpt"].values
    )
    initial = cost(designs["uOpt"])
    heading = f"Cost of the spreads against the travel limit (ride ≤ {RIDE:g}, H = {HOLDING:g} m)"
    told = (
        "Above the line, spreads must be tighter than the initial ones; at the crosses no choice of spreads meets all "
        "limits."
    )
    line = {f"initial spreads ${initial:.2f}": initial}
    page.add(front(costs, heading, told, "7.3", **over_r, y="Cost of the spreads", y_unit="$", limits=line))
    heading = "Why there is no apportioned design for narrow travel"
    told = (
        "Where uOpt lies above the ride limit, aOpt must tighten spreads to meet it. In the grey band even that is not "
        "enough: the load mₛ and the tyre kᵤ keep their spreads."
    )
    line = {f"ride limit of aOpt, {RIDE:g}": RIDE}
    linked = front(over_travel, heading, told, "7.4", **over_r, **ride, limits=line)
    shaded(linked.figures[0], "aOpt", costs["aOpt"])
    page.add(linked)
    if costs["aOpt"].solved.any():
        page.add(views.apportioned(costs["aOpt"]))

    page.section("Evidence")
    page.add(reporting.evidence_table(evidence))
    for text, name, unit, limit in (
        (views.RIDE_TEXT, "Ride", RIDE_UNIT, RIDE),
        (views.HOLDING_TEXT, "Holding", "m", HOLDING),
    ):
        counted = {name: one.functionals[text] for name, one in evidence.items()}
        figure = reporting.percentile_figure(counted, x=name, unit=unit, limit=limit)
        told = "Whiskers: 5 to 95 % of the cars; boxes: 25 to 75 %; dashed: the mean. The ride limit binds aOpt only."
        page.add(Drawing([figure], f"{name} over random cars", told))
    page.add(reporting.evidence_table({f"{name} (±{NARROW:g} m)": one for name, one in narrow_evidence.items()}))
    if counted := {f"{name} to build": one.evidence for name, one in built.items() if one.evidence}:
        page.add(reporting.evidence_table(counted))

    page.section("Comparison with published values", folded=True)
    page.add(views.published_table(designs, narrow_evidence, costs["aOpt"], over_holding), printed=True)

    if not quick:  # one car on 2800 steps: the states of 168 cars would be two million variables
        add_second_way(page, "dOpt", page.study.problems["dOpt"], most_states=STATES)

    page.section("Certificate", folded=True)
    certified = {**designs, **{f"{name} (narrow)": one for name, one in narrow.items()}}
    certified |= {f"{name} to build": one.solution for name, one in built.items()}
    page.add(reporting.certificate_table(certified))


def build(
    page: Draft, designs: Mapping[str, al.Solution], evidence: Mapping[str, al.results.Evidence]
) -> dict[str, al.results.Calibration]:
    """The margins with which no more than `TARGET` of the cars break the limits of a design, and these designs."""
    page.section("The designs to build")
    built = dict[str, al.results.Calibration]()
    for name, (start, limits) in {
        "uOpt": (robust_problem(TRAVEL, HOLDING, MARGIN), ("travel", "holding")),
        "aOpt": (apportionment_problem(TRAVEL, HOLDING, RIDE, MARGIN, RIDE_MARGIN), ("travel", "holding", "ride")),
    }.items():
        built[name] = al.calibrate(start, limits, TARGET, samples=20_000, progress=page.progress)
        page.keep("built", {name: built[name].solution})
        page.keep("built_evidence", {name: built[name].evidence})
        page.keep("margins", {name: built[name]})
    page.add(views.built_table(designs, evidence, built), printed=True)
    page.add(*(margin(f"The margin to build {name} with", one) for name, one in built.items()))
    return built


def recommended(
    designs: Mapping[str, al.Solution],
    evidence: Mapping[str, al.results.Evidence],
    built: Mapping[str, al.results.Calibration],
) -> reporting.Verdict:
    """The robust design with the margin at which few enough cars exceed a limit, beside the printed one; in a quick run
    the printed one, beside the best for the nominal car.
    """
    margin, beside = built.get("uOpt"), "uOpt" if built else "dOpt"
    sentences = []
    if built and built["aOpt"].confirmed:
        sentences.append(
            f"Where ride has to stay within {given(RIDE, RIDE_UNIT)} as well, the spreads of spring and damper must be "
            f"chosen too, for ${cost(built['aOpt'].solution):.2f} instead of ${cost(designs['uOpt']):.2f}: see 'The "
            "designs to build'."
        )
    return reporting.recommendation(
        margin.solution if margin else designs["uOpt"],
        margin.evidence if margin else evidence["uOpt"],
        labels={"k_s.mean": "spring", "b_s.mean": "damper"},
        nominal=designs[beside],
        compared={"with the printed margin" if built else "for the best nominal car": evidence[beside]},
        confirmation=margin.confirmation if margin else None,
        target=TARGET,
        who="cars",
        objective="ride",
        change=("rougher", "smoother"),
        not_verified=["the road of the dissertation, which is not published: this one has its bumps and other noise"],
        sentences=sentences,
    )


def swept(
    page: Draft, group: str, problems: Mapping[str, al.Problem], bound: str, values: Any
) -> dict[str, al.results.Front]:
    """The fronts of problems over one bound by their names, kept as a group."""
    return gathered(page, group, lambda one: al.pareto(one, bound, values, progress=page.progress), problems)


def margin(heading: str, found: al.results.Calibration) -> Drawing:
    """The search for margins."""
    return margin_drawing(found, heading, "cars", views.margins_text(found.margins))
