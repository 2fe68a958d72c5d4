"""The numbers on the page of the time-optimal study: published and reference values, the effect of a margin."""

import numpy as np
import scipy

from aleator.reporting import Table, given, number, percent, share_text
from aleator.studies._motion.facts import duration
from aleator.studies._motion.family import Family
from aleator.studies._motion.printed import compared
from aleator.studies._motion.results import MotionResults
from aleator.studies.pick_and_place_time._run import MEAN, ONE, SIGMAS, WORST

REFERENCE = {MEAN: 1.4142, ONE: 1.5938}
PUBLISHED = {MEAN: 1.12, ONE: 1.20}


def predicted_share(sigmas: float) -> float:
    """The share of payloads more than `sigmas` standard deviations from the mean: `1 - a/√3` if uniform."""
    return max(0.0, 1.0 - sigmas / np.sqrt(3.0))


def torques_of(family: Family, *, nominal: bool = False) -> dict[str, np.ndarray]:
    """Both torques of all systems, or of the nominal one alone, shape (systems, instants), N m."""
    outputs = family.nominal if nominal else family.systems
    return {text: np.atleast_2d(outputs[name]) for text, name in (("τ₁", "q1_torque"), ("τ₂", "q2_torque"))}


def published_table(done: MotionResults) -> Table:
    """Published values and those of an independent program, compared with ours."""
    rows, ours = [], {name: duration(plan) for name, plan in done.plans.items()}
    for name, plan in done.plans.items():
        printed, reference = PUBLISHED.get(name), REFERENCE.get(name)
        rows.append(
            [
                name,
                "–" if printed is None else given(printed, "s"),
                "–" if reference is None else f"{reference:.4f} s",
                number(duration(done.coarse[name]), 5, "s") if name in done.coarse else "–",
                number(duration(plan), 5, "s"),
            ]
        )
    note = (
        "Reference: an independent program for the same arm, with limits only at the 91 instants. The published times "
        "cannot be reproduced: the dissertation gives neither the arm's inertias nor its obstacle, and no arm whose "
        f"parameters are all one has both of its times. {compared(PUBLISHED, ours, 'the published times')}"
    )
    header = ["t_f", "Published", "Reference", "Ours, at the instants", "Ours, between them too"]
    return Table("Published and reference values compared with ours", header, rows, note)


def margins_table(done: MotionResults) -> Table:
    """The share of payloads outside a margin: in closed form, and counted."""
    rows = []
    for name in (ONE, WORST):
        if (one := done.evidence.get(name)) and name in done.families:
            rows.append(
                [
                    name,
                    percent(predicted_share(SIGMAS[name])),
                    share_text(one.violations["torque"]),
                    number(_largest_skewness(done.families[name]), 2),
                ]
            )
    header = ["Plan", "Payloads outside μ ± a·σ", "Payloads that overload a joint", "Largest skewness of a torque"]
    note = (
        "Skewness is that of the sampled torques at the instant where it is largest; its sampling error is "
        f"{number(float(np.sqrt(6 / done.effort.family)), 2)}."
    )
    return Table("The effect of a margin", header, rows, note)


def _largest_skewness(family: Family) -> float:
    found = [scipy.stats.skew(rows, axis=0) for rows in torques_of(family).values()]
    return float(np.nanmax(np.abs(found)))
