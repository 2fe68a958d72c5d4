"""The chapters of the effort-optimal study's page: the motion, histories, a front, a wider payload."""

from collections.abc import Iterator, Mapping, Sequence

import aleator as al
from aleator.reporting import Block, Drawing, Text, front_figure, linked_front
from aleator.studies._motion.family import Family
from aleator.studies._motion.views import SHADES, angles_figure, animations, joints_and_tip, tip_paths, torques_figure
from aleator.studies.pick_and_place_effort._facts import LESSON, UNIT, spreads_table
from aleator.studies.pick_and_place_effort._run import LEAST, MEAN, ROBUST, WIDE, Spread
from aleator.studies.two_link_arm import TARGET, TORQUE
from aleator.studies.two_link_arm._views import SCENE, TIP, joints, touches

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


def motion(families: Mapping[str, Family], names: Sequence[str]) -> Iterator[Block]:
    """The plans in motion; `names` are all plans of the study."""
    shown = [name for name in (MEAN, ROBUST) if name in families]
    if not shown:
        return
    yield animations(families, shown, joints, TIP, SCENE, names)
    figures = [tip_paths(one, name, joints, TIP, SCENE, touches(one), names) for name, one in families.items()]
    caption = (
        "With another payload, the same torques lead elsewhere. Arms that touch obstacle or wall, with either link, "
        "are highlighted."
    )
    yield Drawing(figures, "Path of the tip", caption)


def histories(families: Mapping[str, Family]) -> Iterator[Block]:
    """Joints, tip and torques over time."""
    numbers = {MEAN: "5.2", ROBUST: "5.3", LEAST: "5.4"}
    for name, number in numbers.items():
        if name in families:
            figures = joints_and_tip(families[name], TARGET, TIP)
            caption = f"Rings: the target. {SHADES}"
            yield Drawing(figures, f"{name.capitalize()} plan on its family", caption, number)
    torques = [
        torques_figure(
            one.times,
            {"τ₁": one.nominal["q1_torque"][None], "τ₂": one.nominal["q2_torque"][None]},
            TORQUE,
            name.capitalize(),
        )
        for name, one in families.items()
    ]
    if torques:
        yield Drawing(torques, "Torques", "They act as planned on every arm, and so have no spread.")


def trade_off(front: al.results.Front | None) -> Iterator[Block]:
    """The trade-off between effort and spread."""
    if front is None:
        return
    fronts = {"least variance": front}
    figure = front_figure(
        fronts,
        x="Effort allowed",
        x_unit=UNIT,
        y="Norm of the tip's variances",
        y_unit="m²",
    )
    caption = (
        "Each point is the plan with the smallest spread of the tip for its effort. The first increases beyond the "
        "robust plan's effort gain most; at the right end the torques are at their limits wherever that helps."
    )
    yield linked_front(fronts, [figure], "The cost of a smaller spread", caption)


def lesson(wide: Family | None, spreads: Mapping[str, Mapping[str, Spread]], names: Sequence[str]) -> Iterator[Block]:
    """The effect of a wider payload distribution on one plan."""
    if wide is None:
        return
    yield Text(LESSON, lead="No single open-loop plan suits widely spread payloads.")
    yield spreads_table(spreads)
    paths = tip_paths(wide, ROBUST, joints, TIP, SCENE, touches(wide), names)
    yield Drawing([angles_figure(wide, "Joints"), paths], f"The robust plan with payload {WIDE}", SHADES)
