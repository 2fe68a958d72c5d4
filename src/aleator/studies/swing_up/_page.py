"""The chapters of the swing-up study's page: the motion, the plans on the family, finer steps, friction."""

from collections.abc import Iterator, Mapping, Sequence

from aleator.reporting import Block, Drawing, Scene, Schematic, Text, given
from aleator.studies._motion.build import CALIBRATED
from aleator.studies._motion.family import Family
from aleator.studies._motion.views import SHADES, animations, joints_and_tip, tip_paths, torques_figure
from aleator.studies.swing_up import MASS_2, TORQUE, DoublePendulum
from aleator.studies.swing_up._drawing import UPRIGHT, pendulum_drawing
from aleator.studies.swing_up._facts import FAR, FRICTION, TIP, friction_table, joints, overloads, steps_table
from aleator.studies.swing_up._run import EXPECTED, MEAN

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


def schematic() -> Schematic:
    """The pendulum as a drawing."""
    caption = (
        f"To scale, hanging at the start and upright at the target. The mass of the second link in kg: {MASS_2}."
        " Only the first joint is driven; both have friction."
    )
    return Schematic([pendulum_drawing(DoublePendulum())], "Double pendulum", caption, "5.8")


def motion(families: Mapping[str, Family], names: Sequence[str]) -> Iterator[Block]:
    """The plans in motion; `names` are all plans of the study."""
    shown = [name for name in (MEAN, EXPECTED) if name in families]
    if not shown:
        return
    yield animations(families, shown, joints, TIP, Scene(), names, "5.9 and 5.12")
    figures = [
        tip_paths(families[name], name, joints, TIP, Scene(), overloads(families[name]), names)
        for name in (*shown, *([CALIBRATED] if CALIBRATED in families else []))
    ]
    caption = "The first joint moves alike in all systems; the tips diverge as the second links swing. Cross: upright."
    yield Drawing(figures, "Path of the tip", caption)


def histories(family: Family | None, torque: str, joint: str) -> Iterator[Block]:
    """Torque, joints and tip over time; `torque` and `joint` are the numbers of the figures that show the same."""
    if family is None:
        return
    figure = torques_figure(family.times, {"τ₁": family.systems["q1_torque"]}, TORQUE)
    yield Drawing([figure], "Torque over time", SHADES, torque)
    figures = joints_and_tip(family, UPRIGHT, TIP)
    yield Drawing(figures, "Joints and tip over time", f"Rings: the target. {SHADES}", joint)


def finer_steps(families: Mapping[str, Family], finer: Mapping[str, Family]) -> Iterator[Block]:
    """The accuracy of the integration steps."""
    if finer:
        yield steps_table(families, finer)


def friction(families: Mapping[str, Family], frictionless: Mapping[str, Family]) -> Iterator[Block]:
    """The effect of friction."""
    if frictionless:
        yield Text(FRICTION)
        yield friction_table(families, frictionless)
