"""Results as the values of a JSON document: documented keys, finite numbers or null."""

from typing import Any

from aleator._core.errors import ProblemError
from aleator.reporting import by_place, designs_document, savable
from aleator.solution import Solution
from aleator.studies import AbstractStudy
from aleator.sweep import Front


def facts_of(job: AbstractStudy) -> dict[str, Any]:
    """A study's verdict, designs and fronts, whatever of them is available."""
    try:
        results, verdict = savable("results", job.results())[0], job.headline()
    except ProblemError:  # told already, where it was saved and printed
        results, verdict = {}, None
    named = {"title": job.title, "verdict": verdict}
    fronts = {place: front_facts(one) for place, one in by_place(results).items() if isinstance(one, Front)}
    return {**named, "designs": designs_document(results), "fronts": fronts}


def front_facts(front: Front) -> dict[str, Any]:
    """A front, point by point."""
    columns = zip(front.values, front.points, front.objectives, front.shadow_prices, front.violations, strict=True)
    return {
        "bound": front.bound,
        "interrupted": front.interrupted,
        "points": [
            {
                "value": value,
                "status": one.status.value,
                "objective": objective,
                "shadow_price": price,
                "violation": violation,
                "decisions": dict(one.decisions) if isinstance(one, Solution) and one.ok else {},
                "why": None if one.ok else one.why(),
            }
            for value, one, objective, price, violation in columns
        ],
    }
