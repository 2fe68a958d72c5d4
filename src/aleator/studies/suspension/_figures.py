"""The figures of chapters 6 and 7, in the order of the study's page, and the quarter car as a drawing."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float

import aleator as al
from aleator.reporting import (
    DASHES,
    Axis,
    Block,
    Drawing,
    count,
    decision_path_figure,
    front_figure,
    given,
    linked_front,
    number,
    projection_figure,
    relative_figure,
    shadow_price_figure,
    signal_figure,
    sketch,
    trajectory_figure,
    words,
)
from aleator.reporting.sketch import Point
from aleator.studies._shared import margin_drawing
from aleator.studies.suspension import GRID, QuarterCar, road
from aleator.studies.suspension._facts import (
    RIDE_UNIT,
    ROBUST_NARROW,
    SPREADS,
    UNITS,
    WIDER_NARROW,
    box,
    cost,
    margins_text,
    start_of,
)
from aleator.studies.suspension._run import HOLDING, NARROW_TRAVEL, RIDE, TRAVEL, SuspensionResults

WIDTH, HEIGHT = 420.0, 410.0
MIDDLE = 165.0
AREA_PER_KG = 32.0
"""Pixels squared of a box for each kilogram."""

SYMBOLS = {"m_s": "mₛ", "m_u": "mᵤ", "k_s": "kₛ", "b_s": "bₛ", "eta": "η", "k_u": "kᵤ"}
BUMP = 40.0
"""Pixels from the road's lowest to its highest point."""

RIDE_NAME, TRAVEL_NAME, HOLDING_NAME = "Ride ∫ z̈ₛ² dt, μ + σ", "Travel limit R", "Holding limit H"
HOW_TO_SEE = "Filled markers: the swept limit is active; open markers: another limit is."


def car_drawing(car: QuarterCar, times: Float[np.ndarray, " samples"], heights: Float[np.ndarray, " samples"]) -> str:
    """The car and its road (s, m) as SVG. An uncertain number is written with `(ξ)` and its half-width or spread.

    The masses are boxes with areas proportional to the masses; heights of the road are exaggerated.
    """
    sprung, unsprung = (_box(mass) for mass in (_mean(car.m_s), _mean(car.m_u)))
    top, wheel, contact = 70.0 + sprung[1], 250.0, 385.0
    under = wheel + unsprung[1]
    left, right = MIDDLE - 32.0, MIDDLE + 32.0
    parts = [
        *_body(MIDDLE, 70.0, sprung, "sprung"),
        *_body(MIDDLE, wheel, unsprung, "unsprung"),
        sketch.spring((left, top), (left, wheel), kind="suspension-spring"),
        sketch.damper((right, top), (right, wheel), kind="suspension-damper"),
        sketch.spring((MIDDLE, under), (MIDDLE, contact), kind="tyre-spring"),
        sketch.path(_road(times, heights, contact), kind="road"),
        sketch.circle((MIDDLE, contact), 3.5, filled=True),
        *_labels(car, (70.0 + sprung[1] / 2, (top + wheel) / 2, wheel + unsprung[1] / 2, (under + contact) / 2)),
        *(
            one
            for name, height in (("zₛ", 70.0 + sprung[1] / 2), ("zᵤ", wheel + unsprung[1] / 2), ("road", contact))
            for one in _place(name, height)
        ),
    ]
    title = "Quarter car: body on spring and damper, wheel on its tyre, over a road with bumps"
    return sketch.drawing(parts, width=WIDTH, height=HEIGHT, title=title)


def _box(mass: float) -> Point:
    """Width and height of the box of a mass, of one shape for all."""
    height = math.sqrt(mass * AREA_PER_KG / 3.0)
    return 3.0 * height, height


def _body(middle: float, top: float, size: Point, kind: str) -> list[str]:
    half = size[0] / 2
    corners = [
        (middle - half, top),
        (middle + half, top),
        (middle + half, top + size[1]),
        (middle - half, top + size[1]),
    ]
    return [sketch.path(corners, kind=kind, width=2.5, closed=True)]


def _labels(car: QuarterCar, rows: tuple[float, float, float, float]) -> list[str]:
    body, between, wheel, tyre = rows
    return [
        sketch.label((MIDDLE, body + 5), said(car, "m_s")),
        sketch.label((MIDDLE + 84, wheel + 5), said(car, "m_u"), anchor="start", size=13.0),
        sketch.label((MIDDLE - 52, between), SYMBOLS["k_s"], anchor="end"),
        sketch.label((MIDDLE + 54, between - 22), said(car, "k_s"), anchor="start", size=13.0),
        sketch.label((MIDDLE + 54, between + 2), said(car, "b_s"), anchor="start", size=13.0),
        sketch.label((MIDDLE + 54, between + 26), said(car, "eta"), anchor="start", size=13.0),
        sketch.label((MIDDLE + 24, tyre + 5), said(car, "k_u"), anchor="start", size=13.0),
    ]


def _place(name: str, height: float) -> list[str]:
    """The upward displacement of a body or the ground."""
    return [
        sketch.path([(14.0, height), (34.0, height)], width=1.2),
        sketch.arrow((24.0, height), (24.0, height - 36.0)),
        sketch.label((24.0, height - 43.0), name),
    ]


def said(car: QuarterCar, name: str) -> str:
    """A number of the car: `mᵤ = 94 kg`, `mₛ(ξ) = 376 ± 47 kg`; what is chosen is `kₛ⁰`, `kₛ¹`."""
    value: Any = getattr(car, name)
    symbol, unit = SYMBOLS[name], UNITS[name]
    middle, half_width = _parameters(value)
    text = _written(middle, f"{symbol}⁰")
    if half_width is not None:
        symbol, text = f"{symbol}(ξ)", f"{text} ± {_written(half_width, f'{symbol}¹')}"
    return f"{symbol} = {text} {unit}".rstrip()


def _parameters(value: Any) -> tuple[Any, Any]:
    if isinstance(value, al.Uniform):
        return value.parameters["mean"], value.parameters["half_width"]
    return value, None


def _mean(value: Any) -> float:
    return float(_parameters(value)[0])


def _written(value: Any, chosen: str) -> str:
    """A number, or the symbol of one that is chosen."""
    return chosen if isinstance(value, al.Decision) else given(float(value))


def _road(times: Float[np.ndarray, " samples"], heights: Float[np.ndarray, " samples"], contact: float) -> list[Point]:
    """The road across the drawing, with the wheel on it."""
    across = np.linspace(44.0, WIDTH - 6.0, 181)
    shares = (across - across[0]) / (across[-1] - across[0])
    rows = np.interp(times[0] + shares * (times[-1] - times[0]), times, heights) * BUMP / np.ptp(heights)
    raised = contact - (rows - np.interp(MIDDLE, across, rows))
    return list(zip(map(float, across), map(float, raised), strict=True))


def _axes(ride_limit: bool) -> dict[str, Axis]:
    return {
        "holding": Axis("Holding", "m", {"limit H": HOLDING}),
        "travel": Axis("Travel", "m", {"limit R": TRAVEL}),
        "ride": Axis("Ride", RIDE_UNIT, {"limit": RIDE} if ride_limit else {}),
    }


def projections(results: SuspensionResults, names: list[str], heading: str, place: str, caption: str) -> Drawing:
    boxes = [box(results.designs[name], name) for name in names]
    planes = (("holding", "travel"), ("holding", "ride"), ("travel", "ride"))
    axes = _axes("aOpt" in names)
    return Drawing([projection_figure(boxes, *plane, axes) for plane in planes], heading, caption, place)


def robust_design(results: SuspensionResults) -> Iterator[Block]:
    signal = signal_figure(np.asarray(GRID.times), np.asarray(road().values), name="Road height", unit="m")
    yield Drawing([signal], "The road", "Four bumps of 0.15 m at 1, 5, 10 and 15 Hz, with noise on top.", "6.2")
    pair = {name: one for name, one in results.travel_fronts.items() if name != "aOpt"}
    if pair:
        yield linked_front(
            pair,
            [_ride_front(pair, TRAVEL_NAME)],
            f"Ride against the travel limit, H = {HOLDING:g} m",
            f"{HOW_TO_SEE} {_transition(pair, 'travel', 'm')} Accounting for uncertainty shifts the whole trade-off "
            "up; where the curves are flat, holding is active and more travel brings no gain.",
            "6.4",
            results.evidence.values(),
        )
        yield _shadow_price(pair, TRAVEL_NAME, "travel", "The value of a centimetre of travel", 0.01, "cm")
    if results.holding_fronts:
        yield linked_front(
            results.holding_fronts,
            [_ride_front(results.holding_fronts, HOLDING_NAME)],
            f"Ride against the holding limit, R = {TRAVEL:g} m",
            f"{HOW_TO_SEE} {_transition(results.holding_fronts, 'holding', 'm')} The robust design changes its active "
            "limit first, because its box meets the travel limit earlier (figure 6.7). Crosses: no design meets all"
            " limits.",
            "6.5",
            results.evidence.values(),
        )
        yield _shadow_price(
            results.holding_fronts, HOLDING_NAME, "holding", "The value of a millimetre of holding", 0.001, "mm"
        )
    both = [name for name in ("dOpt", "uOpt") if name in results.designs]
    if len(both) == 2:
        yield projections(
            results,
            both,
            "Why uncertainty changes the active limit",
            "6.6",
            "With the same limits, different ones are active: dOpt lies on the holding limit; uOpt's box touches the "
            "travel limit, which keeps its mean away from both.",
        )
    if results.boxes:
        yield _holding_boxes(results)
    if results.holding_fronts:
        yield _decision_path(results)


def _ride_front(fronts: dict[str, al.results.Front], x: str) -> Any:
    return front_figure(fronts, x=x, x_unit="m", y=RIDE_NAME, y_unit=RIDE_UNIT)


def _shadow_price(
    fronts: dict[str, al.results.Front], x: str, bound: str, heading: str, scale: float, unit: str
) -> Drawing:
    figure = shadow_price_figure(
        fronts, x=x, x_unit="m", y="Shadow price of the limit", y_unit=f"{RIDE_UNIT} per {unit}", scale=scale
    )
    return Drawing(
        [figure],
        heading,
        f"The multiplier of the {bound} limit: the improvement of ride if it is relaxed by 1 {unit}. Zero: relaxing it "
        "brings no gain.",
    )


def _transition(fronts: dict[str, al.results.Front], bound: str, unit: str) -> str:
    """Up to which value of its limit it is active on each front."""
    parts = []
    for name, front in fronts.items():
        held = [
            value for value, one in zip(front.values, front.optima, strict=True) if one and one.multiplier(bound) > 0
        ]
        if held:
            parts.append(f"{name} up to {number(max(held), 3, unit)}")
    return f"The {bound} limit is active for {words(parts)}." if parts else ""


def _holding_boxes(results: SuspensionResults) -> Drawing:
    boxes, limits = [], {}
    for name, front in results.boxes.items():
        for value, one, dash in zip(front.values, front.optima, DASHES, strict=False):
            limits[f"H = {value:g}"] = float(value)
            if one:
                boxes.append(box(one, name, dash, f"H = {value:g} m"))
    axes = {"holding": Axis("Holding", "m", limits), "travel": Axis("Travel", "m", {"limit R": TRAVEL})}
    return Drawing(
        [projection_figure(boxes, "holding", "travel", axes, height=520)],
        "From an active holding limit to an active travel limit",
        "Each box has the line style of its holding limit. As H grows, uOpt's box rises until it meets the travel "
        "limit, and stays there: its last boxes coincide. dOpt, a point, still follows H.",
        "6.7",
    )


def _decision_path(results: SuspensionResults) -> Drawing:
    lowest = float(next(iter(results.designs.values())).problem.placements.decisions["k_s.mean"].decision.lower)
    figure = decision_path_figure(
        results.holding_fronts,
        "b_s.mean",
        "k_s.mean",
        x="Damper, mean bₛ (N s/m)",
        y="Spring, mean kₛ (N/m)",
        bound_unit="m",
        lower=lowest,
        lower_text=f"lower bound of kₛ, {number(lowest)} N/m",
    )
    caption = (
        "Along figure 6.5 mainly the damper changes; the spring leaves its lower bound only at the tightest holding "
        "limits. Labels: the tightest limit that each design reaches."
    )
    return Drawing([figure], f"Spring and damper along the front, R = {TRAVEL:g} m", caption, "6.8")


def violations(results: SuspensionResults) -> Iterator[Block]:
    captions = {
        "dOpt": (
            "6.9",
            "The deterministic design on random cars: best for the nominal car, without reserve for the others.",
        ),
        ROBUST_NARROW: ("6.10 a", "The robust design with a margin of 1 σ: a narrow bundle, with few cars outside."),
        WIDER_NARROW: ("6.10 b", "With a slightly larger margin, a = 1.25, violations become rare."),
    }
    for name, (label, caption) in captions.items():
        if one := results.narrow_evidence.get(name):
            figure = trajectory_figure(one, "travel", y="Travel", unit="m", who="cars")
            samples = f" Counted on {count(one.samples)} cars."
            yield Drawing([figure], f"{name}, travel within ±{NARROW_TRAVEL:g} m", caption + samples, label)
    for name, one in results.built.items():
        yield margin_drawing(one, f"The margin to build {name} with", "cars", margins_text(one.margins))
    if results.calibration is not None:
        yield margin_drawing(results.calibration, "The margin that meets the target for violations", "cars")


def apportionment(results: SuspensionResults) -> Iterator[Block]:
    front = results.travel_fronts.get("aOpt")
    rides = {name: one for name, one in results.travel_fronts.items() if name != "aOpt"}
    if front is not None:
        start = results.designs.get("uOpt") or results.designs.get("dOpt")
        costs = {"aOpt": front}
        yield linked_front(
            costs,
            [
                front_figure(
                    costs,
                    x=TRAVEL_NAME,
                    x_unit="m",
                    y="Cost of the spreads",
                    y_unit="$",
                    limits={} if start is None else {f"initial spreads ${cost(start):.2f}": cost(start)},
                )
            ],
            f"Cost of the spreads against the travel limit (ride ≤ {RIDE:g}, H = {HOLDING:g} m)",
            f"{HOW_TO_SEE} Above the line, spreads must be tighter than the initial ones; at the crosses no choice of "
            "spreads meets all limits.",
            "7.3",
            results.evidence.values(),
        )
    if rides:
        yield linked_front(
            rides,
            [
                front_figure(
                    rides,
                    x=TRAVEL_NAME,
                    x_unit="m",
                    y=RIDE_NAME,
                    y_unit=RIDE_UNIT,
                    limits={f"ride limit of aOpt, {RIDE:g}": RIDE},
                    infeasible={} if front is None else {"aOpt": front},
                )
            ],
            "Why there is no apportioned design for narrow travel",
            "Where uOpt lies above the ride limit, aOpt must tighten spreads to meet it. In the grey band even that is "
            "not enough: the load mₛ and the tyre kᵤ keep their spreads.",
            "7.4",
            results.evidence.values(),
        )
    if front is not None and front.solved.any():
        names = {name: f"{text} (initially ±{_initial(front, name)})" for name, text in SPREADS.items()}
        figure = relative_figure(front, names, x=TRAVEL_NAME, x_unit="m", y="Half-width (% of its initial value)")
        caption = (
            "The spreads that each travel limit allows, relative to the initial ones: above 100 % they are cheaper, "
            "below more expensive. Bounds of the search: 5 % and 400 %."
        )
        yield Drawing([figure], "Apportioned spreads against the travel limit", caption, "7.5")


def _initial(front: al.results.Front, name: str) -> str:
    return given(start_of(front.solutions[0], name), UNITS[name.split(".")[0]])
