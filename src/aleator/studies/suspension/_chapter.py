"""The suspension study: three designs of a quarter car, how often their cars exceed limits, and which one to build."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

import aleator as al
from aleator.reporting import (
    Code,
    Drawing,
    Schematic,
    certificate_table,
    count,
    evidence_table,
    given,
    linked_front,
    percentile_figure,
    recommendation,
    signal_figure,
    trajectory_figure,
)
from aleator.studies._shared import add_second_way, gathered, margin_drawing, picture, sampled
from aleator.studies._study import Draft
from aleator.studies.suspension import (
    GRID,
    apportionment_problem,
    deterministic_problem,
    road,
    robust_problem,
)
from aleator.studies.suspension._views import (
    HOLDING,
    HOLDING_TEXT,
    NARROW,
    RIDE,
    RIDE_TEXT,
    RIDE_UNIT,
    TRAVEL,
    apportioned,
    built_table,
    cost,
    curves,
    decision_path,
    designs_table,
    dollars,
    holding_boxes,
    margins_text,
    projections,
    published_table,
    shadow_price,
    transition,
)

TARGET = 0.01
MARGIN, RIDE_MARGIN = 1.6, 2.4
"""The initial margins of the search for those to build with, of travel and holding, and of ride. Their ratio is kept.

Equation (119) adds the standard deviations of both masses, more than that of their distance, and ride is skewed
upwards; so ride needs a larger multiple of σ for the same share. With one margin for all, no spreads keep the limits in
99 of 100 cars; of the ratios between 1.3 and 1.7, this one has the lowest cost, to a tenth.
"""
BUILT = {"uOpt": ("travel", "holding"), "aOpt": ("travel", "holding", "ride")}
"""The designs to build, and their limits, which no more than `TARGET` of the cars may break."""

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
    ("μ, σ", "Mean and standard deviation over all cars."),
    ("Margin a", "The limit applies to μ + a·σ. It makes violations rare; only counting shows how rare."),
    ("Half-width", "A uniform distribution extends from the mean minus to the mean plus its half-width."),
    ("Active", "A limit that the design meets with equality: without it, a better design would exist."),
    ("Shadow price", "The improvement of the objective per unit by which an active limit is relaxed."),
    ("95 % interval", "Clopper and Pearson: encloses the true share of cars in at least 95 of 100 such countings."),
)
LEFT_OUT = "the margins to build with, and the check by direct collocation"
STATES = 4 * 5601
"""The states of the nominal car at the points of its mesh: in the second way this one car takes seconds."""
LABELS = {"k_s.mean": "spring", "b_s.mean": "damper"}
FILLED = "Filled markers: the swept limit is active; open markers: another limit is."


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
    profile = road()
    heights = np.asarray(profile.values)
    page.add(
        Schematic(
            [picture("suspension/car.svg")],
            "Quarter car on its road",
            "The size of boxes shows their masses; the road is that of the model. ± is the half-width of a uniform "
            "distribution; means that a design chooses have the index 0. The damper is η times as strong in compression"
            " as in extension.",
            "6.1 and 6.3",
            [
                Code(f"The problem of {name} as mathematics", str(problem))
                for name, problem in page.study.problems.items()
            ],
        ),
        Drawing(
            [signal_figure(np.asarray(GRID.times), heights, name="Road height", unit="m")],
            "The road",
            "Four bumps of 0.15 m at 1, 5, 10 and 15 Hz, with noise on top.",
            "6.2",
        ),
    )

    page.section("The three designs")
    designs = gathered(page, "designs", al.solve, page.study.problems)
    evidence = sampled(page, designs, samples)
    caption = "Points are means, boxes extend one σ to each side. dOpt has no spread, and lies on the holding limit. "
    page.add(designs_table("Decisions, performance and violations", designs, evidence), printed=True)
    page.add(
        projections(
            designs,
            "The designs among their limits",
            "7.2",
            f"{caption}The box of uOpt ends at the travel limit, so its mean had to move inward. aOpt has the largest"
            " box: its spreads grow until they meet the ride and travel limits.",
        )
    )

    built: dict[str, al.results.Calibration] = {}
    if quick:
        page.recommend(recommended(designs["uOpt"], evidence["uOpt"], designs, evidence))
    else:
        page.section("The designs to build")
        for name, start in margin_problems().items():
            built[name] = al.calibrate(start, BUILT[name], TARGET, samples=20_000, progress=page.progress)
            page.keep("built", {name: built[name].solution})
            page.keep("built_evidence", {name: built[name].evidence})
            page.keep("margins", {name: built[name]})
        page.recommend(recommended(built["uOpt"].solution, built["uOpt"].evidence, designs, evidence, built))
        page.add(built_table(designs, evidence, built), printed=True)
        page.add(*(_margin(f"The margin to build {name} with", one) for name, one in built.items()))

    chosen = designs | {name: one.solution for name, one in built.items()}

    page.section("How often cars exceed a narrow travel")
    narrow = gathered(page, "narrow", al.solve, narrow_problems())
    few = min(samples, 20_000)  # shares of a tenth, to half a percent
    narrow_evidence = sampled(page, narrow, few, "narrow_evidence")
    lessons = {
        "dOpt": ("6.9", "The deterministic design: best for the nominal car, without reserve for the others."),
        "uOpt, 1 σ": ("6.10 a", "The robust design with a margin of 1 σ: a narrow bundle, with few cars outside."),
        "uOpt, 1.25 σ": ("6.10 b", "With a slightly larger margin, a = 1.25, violations become rare."),
    }
    for name, (label, lesson) in lessons.items():
        figure = trajectory_figure(narrow_evidence[name], "travel", y="Travel", unit="m", who="cars")
        told = f"{lesson} Counted on {count(few)} cars."
        page.add(Drawing([figure], f"{name}, travel within ±{NARROW:g} m", told, label))
    if not quick:
        exact = al.calibrate(robust_problem(NARROW, HOLDING), "travel", TARGET, samples=20_000, progress=page.progress)
        page.keep("calibration", exact)
        page.add(_margin("The margin that meets the target for violations", exact))

    page.section("Trade-offs of ride")
    shown = list(evidence.values()), chosen["uOpt"]
    nominal_and_robust = {"dOpt": deterministic_problem(), "uOpt": robust_problem()}
    over_travel = _swept(page, "travel_fronts", nominal_and_robust, "travel", np.linspace(0.25, 0.145, points))
    rides = curves(over_travel, "Travel limit R", "Ride ∫ z̈ₛ² dt, μ + σ", RIDE_UNIT)
    told = f"{FILLED} {transition(over_travel, 'travel')} Accounting for uncertainty shifts the whole trade-off up; "
    told += "where the curves are flat, holding is active and more travel brings no gain."
    page.add(
        linked_front(over_travel, [rides], f"Ride against the travel limit, H = {HOLDING:g} m", told, "6.4", *shown),
        shadow_price(over_travel, "Travel limit R", "centimetre of travel", 0.01, "cm"),
    )
    over_holding = _swept(page, "holding_fronts", nominal_and_robust, "holding", np.linspace(0.0365, 0.0280, points))
    rides = curves(over_holding, "Holding limit H", "Ride ∫ z̈ₛ² dt, μ + σ", RIDE_UNIT)
    told = f"{FILLED} {transition(over_holding, 'holding')} The robust design changes its active limit first, because "
    told += "its box meets the travel limit earlier (figure 6.7). Crosses: no design meets all limits."
    page.add(
        linked_front(over_holding, [rides], f"Ride against the holding limit, R = {TRAVEL:g} m", told, "6.5", *shown),
        shadow_price(over_holding, "Holding limit H", "millimetre of holding", 0.001, "mm"),
        projections(
            {name: designs[name] for name in ("dOpt", "uOpt")},
            "Why uncertainty changes the active limit",
            "6.6",
            "With the same limits, different ones are active: dOpt lies on the holding limit; uOpt's box touches the "
            "travel limit, which keeps its mean away from both.",
        ),
    )
    page.add(
        holding_boxes(over_holding),
        decision_path(over_holding, float(designs["dOpt"].problem.placements.decisions["k_s.mean"].decision.lower)),
    )

    page.section("Apportioned spreads")
    costs = _swept(
        page, "travel_fronts", {"aOpt": apportionment_problem(ride=RIDE)}, "travel", over_travel["uOpt"].values
    )
    initial = cost(designs["uOpt"])
    limits = {f"initial spreads ${initial:.2f}": initial}
    priced = curves(costs, "Travel limit R", "Cost of the spreads", "$", limits=limits)
    heading = f"Cost of the spreads against the travel limit (ride ≤ {RIDE:g}, H = {HOLDING:g} m)"
    told = f"{FILLED} Above the line, spreads must be tighter than the initial ones; at the crosses no choice of "
    told += "spreads meets all limits."
    page.add(linked_front(costs, [priced], heading, told, "7.3", evidence.values(), chosen["aOpt"]))
    bounds: dict[str, Any] = {"limits": {f"ride limit of aOpt, {RIDE:g}": RIDE}, "infeasible": costs}
    rides = curves(over_travel, "Travel limit R", "Ride ∫ z̈ₛ² dt, μ + σ", RIDE_UNIT, **bounds)
    heading = "Why there is no apportioned design for narrow travel"
    told = "Where uOpt lies above the ride limit, aOpt must tighten spreads to meet it. In the grey band even that is "
    told += "not enough: the load mₛ and the tyre kᵤ keep their spreads."
    page.add(linked_front(over_travel, [rides], heading, told, "7.4", *shown))
    if costs["aOpt"].solved.any():
        page.add(apportioned(costs["aOpt"]))

    page.section("Evidence")
    page.add(evidence_table(evidence))
    for text, label, unit, limit in ((RIDE_TEXT, "Ride", RIDE_UNIT, RIDE), (HOLDING_TEXT, "Holding", "m", HOLDING)):
        counted = {name: one.functionals[text] for name, one in evidence.items()}
        figure = percentile_figure(counted, x=label, unit=unit, limit=limit)
        told = "Bars: 1 to 99 %, 5 to 95 % and 25 to 75 % of the cars. The ride limit binds aOpt only."
        page.add(Drawing([figure], f"{label} over random cars", told))
    at_narrow = {f"{name} (±{NARROW:g} m)": one for name, one in narrow_evidence.items()}
    page.add(evidence_table(at_narrow))
    if to_build := {f"{name} to build": one.evidence for name, one in built.items() if one.evidence}:
        page.add(evidence_table(to_build))

    page.section("Comparison with published values", folded=True)
    page.add(published_table(designs, narrow_evidence, costs["aOpt"], over_holding), printed=True)

    if not quick:  # one car on 2800 steps: the states of 168 cars would be two million variables
        add_second_way(page, "dOpt", page.study.problems["dOpt"], most_states=STATES)

    page.section("Certificate", folded=True)
    page.add(certificate_table(designs), certificate_table({f"{name} (narrow)": one for name, one in narrow.items()}))
    if built:
        page.add(certificate_table({f"{name} to build": one.solution for name, one in built.items()}))


def margin_problems() -> dict[str, al.Problem]:
    """The problems with which the search for the margins to build with begins."""
    return {
        "uOpt": robust_problem(TRAVEL, HOLDING, MARGIN),
        "aOpt": apportionment_problem(TRAVEL, HOLDING, RIDE, MARGIN, RIDE_MARGIN),
    }


def narrow_problems() -> dict[str, al.Problem]:
    """The problems of figures 6.9 and 6.10."""
    return {
        "dOpt": deterministic_problem(NARROW, HOLDING),
        "uOpt, 1 σ": robust_problem(NARROW, HOLDING, 1.0),
        "uOpt, 1.25 σ": robust_problem(NARROW, HOLDING, 1.25),
    }


# --- What to build -------------------------------------------------------------------------------------------------


def recommended(
    design: al.Solution,
    counted: al.results.Evidence | None,
    designs: Mapping[str, al.Solution],
    evidence: Mapping[str, al.results.Evidence],
    built: Mapping[str, al.results.Calibration] | None = None,
) -> Any:
    """The robust design with the margin at which few enough cars exceed a limit; its price against the printed one."""
    printed = not built
    return recommendation(
        design,
        counted,
        labels=LABELS,
        nominal=designs["dOpt" if printed else "uOpt"],
        compared={
            "for the best nominal car" if printed else "with the printed margin": evidence[
                "dOpt" if printed else "uOpt"
            ]
        },
        confirmation=built["uOpt"].confirmation if built else None,
        target=TARGET,
        who="cars",
        objective="ride",
        change=("rougher", "smoother"),
        not_verified=["the road of the dissertation, which is not published: this one has its bumps and other noise"],
        sentences=[*_cheaper(designs, built or {})],
    )


def _cheaper(designs: Mapping[str, al.Solution], built: Mapping[str, al.results.Calibration]) -> Iterator[str]:
    """What it costs to keep the ride as well, by choosing manufacturing spreads."""
    if "aOpt" in built and built["aOpt"].confirmed:
        today, chosen = cost(designs["uOpt"]), cost(built["aOpt"].solution)
        yield (
            f"Where ride has to stay within {given(RIDE, RIDE_UNIT)} as well, the spreads of spring and damper must be "
            f"chosen too, for {dollars(chosen)} instead of {dollars(today)}: see 'The designs to build'."
        )


def _swept(page: Draft, group: str, problems: Mapping[str, al.Problem], bound: str, values: Any) -> Any:
    """The fronts of problems over one bound by their names, kept as a group."""
    return gathered(page, group, lambda one: al.pareto(one, bound, values, progress=page.progress), problems)


def _margin(heading: str, found: al.results.Calibration) -> Drawing:
    return margin_drawing(found, heading, "cars", margins_text(found.margins))
