"""Lower limits are held as upper ones are: by margins between instants, and by the worst of all systems."""

from types import SimpleNamespace

import numpy as np
import pytest

import aleator as al
from aleator.certification._between import tightened
from aleator.nlp import NonlinearProgram


def test_margins_narrow_both_sides_of_a_limit_at_their_instants():
    program = NonlinearProgram(
        evaluate=lambda _: pytest.fail("nothing is evaluated"),
        start=np.zeros(1),
        lower=np.full(1, -np.inf),
        upper=np.full(1, np.inf),
        constraint_lower=np.array([-np.inf, *3 * [-1.0]]),
        constraint_upper=np.array([0.5, *3 * [2.0]]),
        constraint_scale=np.ones(4),
        variable_scale=np.ones(1),
    )
    transcribed = SimpleNamespace(program=program, rows=(slice(0, 1), slice(1, 4)))
    narrower = tightened(transcribed, (None, np.array([0.0, 0.1, 0.2])))
    np.testing.assert_allclose(narrower.constraint_lower, [-np.inf, -1.0, -0.9, -0.8])
    np.testing.assert_allclose(narrower.constraint_upper, [0.5, 2.0, 1.9, 1.8])


class Bowl(al.AlgebraicSystem):
    """A depth whose least value is inside the range of an uncertain place, not at an end of it."""

    level: al.Number
    place: al.Number

    def outputs(self):
        return {"depth": self.level + (self.place - 0.3) ** 2}


def test_a_lower_limit_on_the_worst_case_holds_where_the_worst_system_is_inside():
    model = Bowl(al.Decision(2.0, -5.0, 5.0), al.Uniform(0.0, half_width=1.0))
    limit = al.output("depth").at_least(0.0, worst_case=True)
    solution = al.solve(al.Problem(model, minimize=al.value("level"), subject_to=[limit]))
    assert solution.objective == pytest.approx(0.0, abs=1e-5)
    assert solution.certificate.worst_case.realisations[0].numbers["place"] == pytest.approx(0.3, abs=1e-2)
