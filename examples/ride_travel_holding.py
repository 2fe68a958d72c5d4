"""What ride, suspension travel and road holding cost one another: a surface of certified designs with their evidence.

Three wishes of a quarter car with uncertain masses, springs and dampers (dissertation, chapter 7): the best ride, the
shortest travel at all times, and the best holding of the road, each with a margin of one standard deviation. Travel at
all times becomes one number, a decision of the problem itself, within which the suspension has to stay.
"""

import aleator as al
from aleator.studies import suspension

STEPS = 2800


def problem() -> al.Problem:
    """The car, whose spring and damper are decided, within a travel that is decided too."""
    travel = al.value("travel")
    extension = suspension.POSITION_S.mean + suspension.POSITION_S.std - suspension.POSITION_U.mean
    compression = suspension.POSITION_S.mean - suspension.POSITION_S.std - suspension.POSITION_U.mean
    return al.Problem(
        suspension.nominal(),
        grid=al.Grid(t_final=2.8, steps=STEPS),
        inputs={"road": suspension.road()},
        minimize=travel,
        subject_to=[
            (extension + suspension.POSITION_U.std - travel <= 0.0).named("extension"),
            (compression - suspension.POSITION_U.std + travel >= 0.0).named("compression"),
        ],
        decisions={"travel": al.Decision(0.2, 0.01, 0.5)},
        expansion=al.Expansion(order=3, tolerance=0.1),
    )


def main(points: int = 18, samples: int = 2000) -> tuple[al.results.TradeOff, al.results.EvidenceOfAll]:
    """Find the surface, and count on fresh cars how often each design leaves its travel."""
    ride, holding = suspension.RIDE, suspension.TYRE
    wishes = {"ride": ride.mean + ride.std, "travel": al.value("travel"), "holding": holding.mean + holding.std}
    surface = al.trade_off(problem(), wishes, points)
    evidence = al.validate_all(surface, samples)
    print(surface)
    print(evidence)
    return surface, evidence


if __name__ == "__main__":
    main()
