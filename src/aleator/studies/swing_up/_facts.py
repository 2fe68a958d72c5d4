"""Numbers and tables of the swing-up study, and its verdict: which swing-up to build, and why."""

from collections.abc import Callable, Iterator, Mapping

import numpy as np

import aleator as al
from aleator.nlp import HELD
from aleator.references._estimate import estimate, group_count
from aleator.reporting import Card, Table, count, given, number, percent, share_text
from aleator.studies._motion.facts import CALIBRATED, compared, duration, violation_cards
from aleator.studies._motion.results import Family, MotionResults
from aleator.studies._motion.views import Outputs, linkage
from aleator.studies.swing_up import SMOOTHING, STEPS, TORQUE, VARIANCE
from aleator.studies.swing_up._run import ENERGY, EXPECTED, FINER, MEAN

LENGTH_1, LENGTH_2 = 0.5, 1.0
TIP = (0.0, LENGTH_1 + LENGTH_2)
REFERENCE = {MEAN: 27.8, EXPECTED: 30.6}
PUBLISHED = {MEAN: ("1060", "5.66"), EXPECTED: ("310", "4.46")}
PUBLISHED_VARIANCE = 0.0032
FAR = 0.2
"""A tip that ends further than this from upright, m, is a miss."""

FRICTION = (
    (
        "The motion of the first joint is given, so the second link obeys its own equation, in which every term but "
        "friction is proportional to its mass: inertia, weight, and the coupling force of the first link. Without "
        "friction the mass cancels, all pendulums of the family swing alike, and the tip has no spread."
    ),
    (
        "Friction also determines the energy: without it energy is conserved, so that any motion that never brakes "
        "costs the same, the difference in potential energy. With it, every second costs energy."
    ),
)


def joints(outputs: Outputs) -> np.ndarray:
    """Pivot, elbow and tip, m."""
    q1 = outputs["q1"]
    return linkage(LENGTH_1 * np.stack([-np.sin(q1), np.cos(q1)], axis=-1), outputs)


def overloads(family: Family) -> np.ndarray:
    """Which systems need more torque than available, at any time."""
    return np.abs(family.extremes["q1_torque"]).max(axis=1) > TORQUE * (1 + HELD)


def missed(family: Family) -> al.results.Proportion:
    """The share of systems that end too far from upright."""
    x, y = (family.systems[name][:, -1] for name in ("tip_x", "tip_y"))
    return al.results.Proportion(int(np.sum(np.hypot(x - TIP[0], y - TIP[1]) > FAR)), len(x))


def terminal_norm(family: Family) -> str:
    """The norm of the tip's variances at the end, m²."""
    ends = np.stack([family.systems[name][:, -1] for name in ("tip_x", "tip_y")], axis=1)
    return _estimated(lambda sample: np.hypot(*sample.var(axis=0, ddof=1)), ends)


def _estimated(statistic: Callable[[np.ndarray], np.ndarray], sample: np.ndarray) -> str:
    """A statistic of the sample, and one standard error of it."""
    found = estimate(statistic, sample, group_count(len(sample)))
    return f"{number(float(found.value), 3)} ± {number(float(found.standard_error), 2)}"


def _ends(family: Family) -> list[str]:
    def largest(torques: np.ndarray) -> np.ndarray:
        return np.max(np.abs(torques.mean(axis=0)) + torques.std(axis=0, ddof=1))

    means = [_estimated(np.mean, family.systems[name][:, -1]) for name in ("q2", "q2_rate")]
    return [*means, terminal_norm(family), _estimated(largest, family.systems["q1_torque"])]


def published_table(done: MotionResults) -> Table:
    """Published values and those of an independent search, compared with ours."""
    printed = {name: float(energy) for name, (energy, _) in PUBLISHED.items()}
    rows, ours = [], {name: plan.objective for name, plan in done.plans.items()}
    for name, plan in done.plans.items():
        energy, time = PUBLISHED.get(name, ("–", "–"))
        family = done.families.get(name)
        rows.append(
            [
                name,
                energy,
                f"{REFERENCE[name]} at most" if name in REFERENCE else "–",
                number(plan.objective, 4),
                time,
                number(duration(plan), 3),
                "–" if name != EXPECTED else given(PUBLISHED_VARIANCE),
                "–" if family is None else terminal_norm(family),
            ]
        )
    note = (
        "The published numbers are called powers, in W, and are sums over an unstated number of samples for another "
        f"friction. {compared(printed, ours, 'the energies')} Reference: the results of an independent search. "
        "Variances are those of the random pendulums flown, ± one standard error of that sample; the true one is "
        f"limited to {given(VARIANCE, 'm²')} in the robust plans only. Powers are rounded off where they are zero, "
        f"which lowers an energy by at most {given(SMOOTHING)} J a second."
    )
    header = [
        "",
        "Published (W)",
        "Reference (J)",
        "Ours (J)",
        "Published t_f (s)",
        "Ours (s)",
        "Published variance (m²)",
        "Ours (m²)",
    ]
    return Table("Published and reference values compared with ours", header, rows, note)


def steps_table(families: Mapping[str, Family], finer: Mapping[str, Family]) -> Table:
    """The same systems with the problem's steps and with finer ones."""
    rows = []
    for name, fine in finer.items():
        for label, family in ((f"{name}, {STEPS} steps", families[name]), (f"{FINER * STEPS}", fine)):
            rows.append([label, *_ends(family)])
    header = [
        "",
        "E[q₂(t_f)] (rad)",
        "E[q̇₂(t_f)] (rad/s)",
        "Variance of the tip (m²)",
        "Largest |μ| + σ of τ₁ (N m)",
    ]
    first = next(iter(finer.values()))
    note = (
        f"The same {count(len(first.systems['q2']))} random pendulums, integrated with RK4 in {STEPS} steps and in "
        f"{FINER} times as many; ± is one standard error of that sample, which both rows of a plan share. Differences "
        "between the rows are integration errors and, in the last column, mainly the peaks between the coarser "
        "instants. The robust plans require true means of zero and a true variance of at most "
        f"{given(VARIANCE, 'm²')}: deviations within the sample's error do not contradict that. The deterministic plan "
        "swings up the pendulum of mean mass, not the mean of all pendulums."
    )
    return Table("The plans with finer steps", header, rows, note)


def final_spread(family: Family) -> float:
    """The standard deviation of the second joint at the end, rad."""
    return float(family.systems["q2"][:, -1].std())


def friction_table(families: Mapping[str, Family], frictionless: Mapping[str, Family]) -> Table:
    """The spread of the second joint, with and without friction."""
    rows = [[name, *(number(final_spread(one[name]), 2) for one in (families, frictionless))] for name in frictionless]
    return Table("σ of q₂ at the end (rad)", ["Plan", "With friction", "Without"], rows)


def sentences(done: MotionResults, frictionless: Mapping[str, Family]) -> Iterator[str]:
    """Sentences on the plans available, and on the effect of friction."""
    if MEAN in done.evidence and MEAN in done.families:
        yield (
            "Do not use the deterministic plan: flown on the family, it breaks the torque limit in"
            f" {share_text(done.evidence[MEAN].joint)} of the cases and misses the target by more than"
            f" {given(FAR, 'm')} in {share_text(missed(done.families[MEAN]))}."
        )
    if {MEAN, EXPECTED} <= set(done.plans) and EXPECTED in done.evidence:
        more = percent(done.plans[EXPECTED].objective / done.plans[MEAN].objective - 1)
        yield (
            f"The robust plan with the published margin, a = 1, swings the family up with {more} more energy, but "
            f"{share_text(done.evidence[EXPECTED].joint)} of the pendulums need more torque than available."
        )
    if {EXPECTED, ENERGY} <= set(done.plans):
        first, second = (done.plans[name] for name in (EXPECTED, ENERGY))
        yield (
            f"Whether the energy of the expected torque is minimised ({number(first.objective, 4, 'J')} in "
            f"{number(duration(first), 3, 's')}) or the expected energy ({number(second.objective, 4, 'J')} in "
            f"{number(duration(second), 3, 's')}) makes little difference: the torque spreads little where power flows."
        )
    if EXPECTED in frictionless and EXPECTED in done.families:
        with_friction, without = (final_spread(one[EXPECTED]) for one in (done.families, frictionless))
        yield (
            f"With friction the mass matters: the second joint ends with σ = {number(with_friction, 2, 'rad')}; "
            f"without friction all masses swing alike (σ = {number(without, 1, 'rad')}), and only the torque would be "
            "uncertain."
        )


def cards(done: MotionResults) -> Iterator[Card]:
    """The energy of the robust plans, and how often they fail."""
    for name in (EXPECTED, CALIBRATED):
        if plan := done.plans.get(name):
            yield Card(f"Energy, {name}", number(plan.objective, 4, "J"), f"in {number(duration(plan), 3, 's')}")
    yield from violation_cards(done.evidence, (EXPECTED, CALIBRATED), "the torque limit")


def left_below(done: MotionResults) -> str:
    """The share of pendulums that miss upright with the plan to build, which no limit of the problem covers."""
    if CALIBRATED not in done.families:
        return ""
    share = share_text(missed(done.families[CALIBRATED]))
    return f" Of the pendulums flown with it {share} end more than {given(FAR, 'm')} from upright."
