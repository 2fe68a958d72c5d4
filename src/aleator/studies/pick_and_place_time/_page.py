"""The chapters of the time-optimal study's page: torques against their limits, the motion, why one σ is so little."""

from collections.abc import Iterator, Mapping, Sequence

from aleator.reporting import Block, Drawing, Section, Text
from aleator.studies._motion.family import Family
from aleator.studies._motion.results import MotionResults
from aleator.studies._motion.views import SHADES, angles_figure, animations, torques_figure
from aleator.studies.pick_and_place_time._facts import margins_table, torques_of
from aleator.studies.pick_and_place_time._run import MEAN, ONE, WORST
from aleator.studies.two_link_arm import TORQUE
from aleator.studies.two_link_arm._views import SCENE, TIP, joints

GLOSSARY = (
    ("Deterministic plan", "The fastest plan for the mean payload (73)."),
    ("Robust plan", "The fastest plan whose torques keep their limits with μ ± a·σ, (80) and (91)."),
    ("μ, σ", "Mean and standard deviation over all payloads."),
    ("Margin a", "The number of σ kept between the mean torque and its limit."),
    ("Inverse dynamics", "The joints follow the plan exactly; the payload changes the torques needed."),
    ("t_f", "Duration of the motion, chosen by the plan."),
)
_WHY = (
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


def chapters(families: Mapping[str, Family], names: Sequence[str]) -> list[Section]:
    """The figures of section 5.5.2; `names` are all plans of the study."""
    return [
        Section("Torques against their limits", list(_torques(families))),
        Section("The motion", list(_motion(families, names))),
    ]


def _torques(families: Mapping[str, Family]) -> Iterator[Block]:
    if MEAN in families:
        times, nominal = families[MEAN].times, torques_of(families[MEAN], nominal=True)
        figures = [
            torques_figure(times, nominal, TORQUE, "The mean payload"),
            torques_figure(times, torques_of(families[MEAN]), TORQUE, "All payloads"),
        ]
        caption = (
            "The fastest plan keeps one torque or the other at its limit almost throughout. Another payload on the "
            f"same path needs more. {SHADES}"
        )
        yield Drawing(figures, "Torques of the deterministic plan", caption, "5.5")
    if robust := {name: families[name] for name in (ONE, WORST) if name in families}:
        figures = [
            torques_figure(one.times, torques_of(one), TORQUE, name.capitalize()) for name, one in robust.items()
        ]
        caption = (
            "The margin moves the bands inside the limits: with a = 1 the dark band of one σ, with a = √3 the light "
            "band of all payloads, since a uniform distribution ends √3 σ from its mean."
        )
        yield Drawing(figures, "Torques of the robust plans", caption, "5.6")


def _motion(families: Mapping[str, Family], names: Sequence[str]) -> Iterator[Block]:
    shown = [name for name in (MEAN, WORST) if name in families]
    if not shown:
        return
    yield animations(families, shown, joints, TIP, SCENE, names)
    figure = angles_figure(families[shown[-1]], shown[-1].capitalize())
    caption = "The joints follow the plan whatever the payload, and so have no spread."
    yield Drawing([figure], "Configuration over time", caption, "5.7")


def why_one_sigma(done: MotionResults) -> Iterator[Block]:
    """Why one σ excludes so many payloads."""
    if done.evidence:
        yield Text(_WHY, lead="Why one σ excludes four payloads in ten.")
        yield margins_table(done)
