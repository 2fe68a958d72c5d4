"""Every bad input ends in one clear sentence that says what was expected and what was received: nothing is accepted."""

import re
import warnings
from pathlib import Path

import jaxtyping
import numpy as np
import pytest

import aleator as al
from bad_inputs import CORPUS, Bad, files
from test_public_names import TOPICS

LONGEST = 400

# Public names that take no arguments, are made by calls, are to be subclassed, or are errors.
NOT_CALLED = {
    "AbstractCovariance",
    "AbstractFit",
    "AbstractIndexSet",
    "AbstractIntegrator",
    "AbstractJoint",
    "AbstractPoints",
    "AbstractScheme",
    "AbstractShape",
    "AbstractSignal",
    "AbstractSolver",
    "AbstractTrajectory",
    "Accelerations",
    "Actuation",
    "AleatorError",
    "AleatorWarning",
    "AlgebraicSystem",
    "Ball",
    "Between",
    "Calibration",
    "CalibrationWarning",
    "CorrelationWarning",
    "JournalWarning",
    "SimulationWarning",
    "Certificate",
    "Checked",
    "Asked",
    "AtMeans",
    "Closure",
    "Costates",
    "Conflict",
    "Limit",
    "TradeOff",
    "Optimum",
    "Portfolio",
    "EvidenceOfAll",
    "Examination",
    "Hardened",
    "Searched",
    "States",
    "Switching",
    "Compared",
    "ConstraintResult",
    "CrossChecked",
    "Contribution",
    "Deviation",
    "Disagreement",
    "Effort",
    "ElementExpanded",
    "Estimate",
    "Evidence",
    "Expanded",
    "ExpansionQuality",
    "ExpansionWarning",
    "Expression",
    "Fixed",
    "Free",
    "Front",
    "GridError",
    "GridWarning",
    "HermiteSimpson",
    "Instant",
    "Interpolation",
    "Lagrangian",
    "MeshError",
    "LeastSquares",
    "Linearised",
    "Mechanical",
    "MissingExtraError",
    "Moments",
    "Motion",
    "Nodes",
    "Parametrised",
    "Multibody",
    "ProblemError",
    "Projection",
    "Proportion",
    "RandomSample",
    "RungeKutta4",
    "Refused",
    "Sampled",
    "SecondOpinion",
    "SecondOrder",
    "Sequential",
    "SimulationError",
    "SobolIndices",
    "Solution",
    "SolveError",
    "Sparse",
    "Starts",
    "Status",
    "System",
    "TensorProduct",
    "Tangent",
    "Times",
    "ToleranceAnalysis",
    "Total",
    "TotalDegree",
    "Trajectories",
    "Trapezoid",
    "Trial",
    "Unseen",
    "WeightedProportion",
    "WorstCase",
    "WorstRealisation",
    "Zone",
    "final_time",
}


@pytest.fixture(autouse=True)
def bare(monkeypatch):
    """As users have it: the tests check shapes and types of annotations, the library itself does not."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


def assert_refused(bad: Bad) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(al.AleatorError) as caught:
            bad.call()
    message = str(caught.value)
    assert len(message) <= LONGEST, f"{len(message)} characters: {message}"
    assert any(word in message for word in bad.received), f"expected one of {bad.received} in: {message}"


@pytest.mark.parametrize("name", CORPUS)
def test_a_bad_input_ends_in_one_sentence_that_names_it(name):
    assert_refused(CORPUS[name])


@pytest.mark.parametrize("name", files(Path("nowhere")))
def test_a_file_that_is_no_table_is_refused_by_name(name, tmp_path):
    assert_refused(files(tmp_path)[name])


def test_the_corpus_covers_every_public_name():
    # What only comes out of calls, is raised or warned of, has no arguments or is to be subclassed is not called here.
    told = " ".join(CORPUS)
    topics = [vars(getattr(al, topic)) for topic in TOPICS]
    given = [
        name
        for place in ({name: getattr(al, name) for name in dir(al)}, *topics)  # what has not been used yet too
        for name, value in place.items()
        if not name.startswith("_") and callable(value) and getattr(value, "__module__", "").startswith("aleator")
    ]
    missing = [name for name in given if not re.search(rf"\b{name}\b", told)]
    assert set(missing) <= NOT_CALLED, sorted(set(missing) - NOT_CALLED)


@pytest.mark.parametrize("whole", [np.int64(3), np.int32(3), np.uint8(3)])
def test_whole_numbers_of_numpy_are_whole_numbers(whole):
    assert al.Expansion(order=whole) == al.Expansion(order=3)
    assert al.points.SobolPoints(whole, whole) == al.points.SobolPoints(3, 3)
    assert al.Grid(1.0, whole).steps == 3
    assert al.BSpline(np.zeros(5), degree=whole).degree == 3
    assert al.solvers.Slsqp(max_rounds=whole).max_rounds == 3


@pytest.mark.parametrize("one", [np.float64(0.5), np.float32(0.5), np.array(0.5)])
def test_numbers_of_numpy_are_numbers(one):
    assert al.index_sets.HyperbolicCross(one) == al.index_sets.HyperbolicCross(0.5)
    assert al.integrators.Tsit5(rtol=one) == al.integrators.Tsit5(rtol=0.5)
    assert str(al.Decision(one)) == str(al.Decision(0.5))
    assert str(one * al.terminal("x").mean) == str(0.5 * al.terminal("x").mean)
