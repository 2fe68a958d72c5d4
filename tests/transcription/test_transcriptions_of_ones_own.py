"""A transcription from outside of the package: `solve`, its certificate and its report speak to the seam alone."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from typing_extensions import override

import aleator as al
from aleator import extending as ext
from zoo import gain_problem


@dataclass(frozen=True, kw_only=True)
class Lifted(ext.AbstractTranscribed):
    """Minimise t over (t, x), subject to f(x) - t <= 0 and to the constraints of a problem transcribed sequentially."""

    inner: ext.AbstractTranscribed

    @classmethod
    def of(cls, inner):
        program = inner.program
        first = program.evaluate(program.start).objective
        size = max(abs(first), 1.0)

        def lifted(point):
            found = program.evaluate(point[1:])
            rows = np.vstack([found.gradient, found.jacobian])
            return ext.Evaluation(
                objective=point[0],
                gradient=np.eye(len(point))[0],
                constraints=np.append(found.objective - point[0], found.constraints),
                jacobian=np.column_stack([np.append(-1.0, np.zeros(len(rows) - 1)), rows]),
            )

        def sizes(point, evaluation):
            return np.append(size, program.sizes(point[1:], program.evaluate(point[1:])))

        whole = ext.NonlinearProgram(
            evaluate=lifted,
            start=np.append(first, program.start),
            lower=np.append(-np.inf, program.lower),
            upper=np.append(np.inf, program.upper),
            constraint_lower=np.append(-np.inf, program.constraint_lower),
            constraint_upper=np.append(0.0, program.constraint_upper),
            constraint_scale=np.append(size, program.constraint_scale),
            variable_scale=np.append(size, program.variable_scale),
            sizes=sizes,
        )
        return cls(
            problem=inner.problem,
            traced=inner.traced,
            discretised=inner.discretised,
            program=whole,
            rows=tuple(slice(1 + one.start, 1 + one.stop) for one in inner.rows),
            scales=inner.scales,
            scenarios=inner.scenarios,
            inner=inner,
        )

    @property
    @override
    def decided(self):
        return np.arange(1, self.program.start.size)

    @override
    def point(self, decisions):
        return np.append(self.inner.program.evaluate(decisions).objective, decisions)

    @override
    def at(self, point):
        return self.inner.at(point[1:])

    @override
    def times(self, point):
        return self.inner.times(point[1:])

    @override
    def at_scenarios(self, scenarios):
        return Lifted.of(self.inner.at_scenarios(scenarios))


@dataclass(frozen=True)
class Epigraph(ext.AbstractTranscription):
    """The epigraph form of a sequential program."""

    @override
    def transcribed(self, problem, meanwhile):
        return Lifted.of(al.Sequential().transcribed(problem, meanwhile))


def test_a_problem_has_the_same_answer_and_certificate_by_another_transcription():
    problem = gain_problem()
    usual, other = al.solve(problem), al.solve(problem, transcription=Epigraph())
    assert other.ok
    assert len(other.multipliers) == len(usual.multipliers) + 1  # what is kept of one is not taken for the other
    assert other.vector.shape == usual.vector.shape
    np.testing.assert_allclose(other.vector, usual.vector, rtol=2e-4)
    assert other.objective == pytest.approx(usual.objective, rel=1e-6)
    for one, same in zip(other.constraints, usual.constraints, strict=True):
        assert (one.name, one.text, np.shape(one.values)) == (same.name, same.text, np.shape(same.values))
        assert one.shadow_price == pytest.approx(same.shadow_price, rel=1e-3, abs=1e-6)
    found, expected = other.certificate, usual.certificate
    assert found.grid_error.objective.error == pytest.approx(expected.grid_error.objective.error, rel=0.1, abs=1e-9)
    assert found.expansion.worst == pytest.approx(expected.expansion.worst, rel=0.1, abs=1e-12)
    assert (found.worst_case is None) == (expected.worst_case is None)


@dataclass(frozen=True)
class Mistaken(ext.AbstractTranscription):
    """An epigraph form with a mistake in it."""

    mistake: str

    @override
    def transcribed(self, problem, meanwhile):
        found = Epigraph().transcribed(problem, meanwhile)
        return replace(found, rows=() if self.mistake == "rows" else (slice(0, 1), *found.rows[1:]))


@pytest.mark.parametrize(
    ("transcription", "message"),
    [
        (Mistaken("rows"), "rows: expected those of 1 constraint"),
        (Mistaken("row"), "constraint 'response': expected equal numbers in the program and in the meaning"),
    ],
)
def test_a_transcription_that_contradicts_itself_is_refused_and_harms_no_other(transcription, message):
    with pytest.raises(al.ProblemError, match=message):
        al.solve(gain_problem(), transcription=transcription)
    assert al.solve(gain_problem()).ok
