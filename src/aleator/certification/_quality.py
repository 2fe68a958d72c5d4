"""How far the expansions of a problem can be trusted at a solution, with warnings if they cannot."""

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from aleator.design import Problem, sizes, statistics_in
from aleator.expansion import ILL_CONDITIONED, unseen
from aleator.solution import ExpansionQuality, SecondOpinion
from aleator.statistics import Covariance, Mean, Std, Variance
from aleator.transcription import AbstractTranscribed, Resolved

# The relative error of an expansion that is tolerated for moments.
_TRUSTED = {Mean: 1.0, Std: 1 / 3, Variance: 1 / 3, Covariance: 1 / 3}

# A spread below this part of the magnitude of a functional's terms is rounding.
_ROUNDING = 1e-11


def quality_of(
    transcribed: AbstractTranscribed, resolved: Mapping[str, Resolved], point: Float[np.ndarray, " variables"]
) -> ExpansionQuality:
    """The quality of the expansions at a point, from `resolved` there."""
    basis, collocation = transcribed.basis, transcribed.collocation
    tolerance, meaning = transcribed.problem.expansion.tolerance, transcribed.at(point)
    errors = {text: float(one.leave_one_out) for text, one in resolved.items()}
    return ExpansionQuality(
        order=basis.order,
        terms=basis.terms,
        points=len(collocation.points),
        condition_number=float(collocation.condition_number),
        leave_one_out=errors | _rounding(transcribed, resolved, errors, meaning.decisions),
        unresolved_from={
            text: float(meaning.times[int(np.argmax(late))])
            for text, one in resolved.items()
            if one.history is not None and (late := ~(np.asarray(one.history) <= tolerance)).any()
        },
        tolerance=tolerance,
        tangents={
            text: dict(zip(transcribed.places.of_distributions, np.asarray(one.tangents).tolist(), strict=True))
            for text, one in resolved.items()
            if one.tangents is not None
        },
        unseen=unseen(basis, np.asarray(collocation.points)),
    )


def _rounding(
    transcribed: AbstractTranscribed,
    resolved: Mapping[str, Resolved],
    errors: Mapping[str, float],
    decisions: Float[np.ndarray, " n"],
) -> dict[str, float]:
    """Unresolved functionals that are numbers and spread by rounding alone, whose error therefore counts as zero.

    For example, the rate at the end of a motion that comes to rest is zero in every system, up to rounding.
    """
    tolerance = transcribed.problem.expansion.tolerance
    suspects = {text for text, error in errors.items() if not error <= tolerance and np.ndim(resolved[text].std) == 0}
    if not suspects:
        return {}
    magnitudes = sizes(transcribed.problem, transcribed.collocation.points[0], jnp.asarray(decisions))
    return {
        text: 0.0
        for text, size in zip(transcribed.texts.functionals, magnitudes, strict=True)
        if text in suspects and float(resolved[text].std) <= _ROUNDING * float(size)
    }


def untrusted(problem: Problem, quality: ExpansionQuality) -> str:
    """A sentence on the statistic whose expansion is least accurate, if too inaccurate to act on; empty if none is.

    An error adds to a variance by its square: a third of the standard deviation is a ninth of the variance. Tails have
    no such advantage, and are trusted only up to the expansion's tolerance; a mean is less sensitive. A user who sets a
    higher tolerance accepts it for all of them.
    """
    worst, sentence = 1.0, ""
    for one in statistics_in(problem.expressions):
        most = max(quality.tolerance, _TRUSTED.get(type(one.kind), 0.0))
        for functional in one.functionals:
            error = quality.leave_one_out.get(functional.text(), 0.0)
            # If no points are left to check it by, the error is infinite, and fresh simulations decide.
            if not np.isinf(error) and not error <= worst * most:
                worst = error / most
                sentence = (
                    f"it misses {functional.text()} by {error:.2g} of its standard deviation, where {one.text()} asks "
                    f"for {most:.2g} at most"
                )
    return sentence


def doubts(quality: ExpansionQuality, opinion: SecondOpinion | None) -> list[str]:
    """Why the statistics of an expansion cannot be trusted, a sentence each; empty if they can."""
    sentences = []
    if not quality.is_conditioned:
        sentences.append(
            f"The collocation matrix has condition number {quality.condition_number:.1e} (limit "
            f"{ILL_CONDITIONED:.0e}), so coefficients lose digits. Use more points, a lower order, or "
            "al.points.ChristoffelPoints()"
        )
    if not quality.can_be_checked:
        sentences.append(
            f"{quality.points} points for {quality.terms} terms leave nothing to check the expansion of order "
            f"{quality.order} by, so whether means and spreads can be trusted is not known. Use more points"
        )
    elif quality.unresolved:
        bad = [f"{text} ({quality.leave_one_out[text]:.2g}){quality.since(text)}" for text in quality.unresolved]
        sentences.append(
            f"The expansion of order {quality.order} does not resolve {', '.join(bad)}: its relative leave-one-out "
            f"error exceeds {quality.tolerance:g}, so means and spreads cannot be trusted. Raise the order"
        )
    if opinion is not None and not opinion.agrees:
        # Without predictions to compare there is a system that has no result, at any order.
        remedy = "Raise the order" if opinion.misses else "Mend the model there, or bound the distributions"
        sentences.append(f"{opinion.sentence()}. {remedy}")
    return sentences
