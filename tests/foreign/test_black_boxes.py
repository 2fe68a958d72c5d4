"""Black boxes against the same functions called directly, bit by bit; and what becomes of samples that fail."""

import re
import sys
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np
import pytest
from boxed_functions import FRESH, ORDER, TWO, Counted, assert_same, directly, odd, refused

import aleator as al
import black_boxes as boxes

# --- The same bits ---------------------------------------------------------------------------------------------------


def test_a_box_gives_the_bits_of_its_function_by_threads_too():
    with ThreadPoolExecutor(4) as executor:
        for how in ({}, {"executor": executor}):
            assert_same(al.expand(al.foreign.BlackBox(boxes.smooth, **how), TWO, ORDER), directly())


def test_outputs_may_choose_terms_and_points():
    counted, expansion = Counted(), al.Expansion(index_set=al.index_sets.Adaptive(error=1e-4))
    expanded = al.expand(al.foreign.BlackBox(counted), TWO, expansion)
    assert_same(expanded, directly(expansion=expansion))
    assert counted.calls == len(expanded.collocation.points) + FRESH


# --- Samples that fail -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (None, "returns nothing"),
        ({"y": 1j, "v": np.zeros(3)}, "complex"),
        ({"y": np.nan, "v": np.zeros(3)}, "output 'y' is nan"),
        ({"y": 1.0}, "arrays of shapes {'y': ()}, where sample 1 had {'v': (3,), 'y': ()}"),
    ],
)
def test_nonsense_is_refused_by_sample_and_inputs(value, said):
    message = refused(al.foreign.BlackBox(odd(value)))
    assert said in message
    assert re.search(r"failed at sample 30 \(x=0\.9\d*, z=[\d.]+\)", message)
    assert "Finished samples are kept by this box (29)" in message


def test_a_function_that_would_end_this_process_fails_one_sample():
    assert "failed at sample 1 (x=" in refused(al.foreign.BlackBox(lambda at: sys.exit(3)))


def test_a_sample_that_fails_once_is_run_again():
    seen = set()

    def moody(at):
        if at["x"] not in seen:
            seen.add(at["x"])
            raise OSError("no licence")
        return boxes.smooth(at)

    counted = Counted(moody)
    assert_same(al.expand(al.foreign.BlackBox(counted, retries=1), TWO, ORDER), directly())
    assert counted.calls == 2 * (30 + FRESH)
    seen.clear()
    assert "OSError: no licence" in refused(al.foreign.BlackBox(moody))


def test_dropped_samples_leave_least_squares_at_the_others_and_a_warning_of_the_bias():
    message = refused(al.foreign.BlackBox(boxes.stiff, drop=0.03), expansion=al.Expansion(order=4))
    assert "2 of 47 samples failed, and drop=0.03 allows 1: 'stiff' failed at sample" in message
    assert "it raised ValueError: no convergence. Finished" in message, "in one line"
    with ThreadPoolExecutor(4) as executor:
        box = al.foreign.BlackBox(boxes.stiff, drop=0.1, executor=executor)
        with pytest.warns(al.SimulationWarning) as caught:
            expanded = al.expand(box, TWO, al.Expansion(order=4))
    message = str(caught[0].message)
    full = directly(expansion=al.Expansion(order=4))
    points = np.asarray(full.collocation.points)
    kept = ~((points[:, 0] > 0.7) & (points[:, 1] > 0.5))  # z = 2 + its germ
    missing = np.count_nonzero(~kept)
    assert message.startswith(f"{missing} of 47 samples of 'stiff' failed and were dropped")
    assert f"where {missing} of {missing} samples failed" in message
    assert "x from 0.7" in message
    assert "may be biased" in message
    # The least squares of the others, computed independently.
    np.testing.assert_array_equal(expanded.collocation.points, points[kept])
    matrix, values = np.asarray(full.collocation.matrix)[kept], np.asarray(full.samples["y"])[kept]
    np.testing.assert_allclose(expanded.coefficients["y"], np.linalg.lstsq(matrix, values)[0], rtol=1e-11, atol=1e-13)


def test_methods_that_need_every_sample_drop_none():
    with pytest.raises(al.SimulationError, match="needs every sample, so that none is dropped"):
        al.expand(al.foreign.BlackBox(odd(None), drop=0.4), TWO, al.MultiElement(order=2))


def test_statistics_of_a_box_have_no_derivatives():
    def spread(half_width):
        return al.expand(al.foreign.BlackBox(lambda at: at["x"]), {"x": al.Uniform(0.0, half_width=half_width)}).std

    with pytest.raises(al.ProblemError, match="is a black box, so nothing can be differentiated"):
        jax.grad(spread)(0.1)
    with pytest.raises(al.ProblemError, match="a black box has no derivatives"):
        al.references.linearise(al.foreign.BlackBox(boxes.smooth), TWO)
