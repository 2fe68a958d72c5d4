"""Black boxes against the same functions called directly, bit by bit; and what becomes of samples that fail."""

import re
import warnings
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np
import pytest
import sklearn  # noqa: F401  it sets variables of the environment when it is first imported
from boxed_functions import ORDER, TWO, Counted, assert_same, directly, odd, refused, spawned

import aleator as al
import black_boxes as boxes
from zoo import Decay

# --- The same bits ---------------------------------------------------------------------------------------------------


def test_a_box_gives_the_bits_of_its_function_by_threads_too():
    with ThreadPoolExecutor(4) as executor:
        for how in ({}, {"executor": executor}):
            assert_same(al.expand(al.foreign.BlackBox(boxes.smooth, **how), TWO, ORDER), directly())


@pytest.mark.slow
def test_spawned_processes_give_the_same_bits():
    with spawned() as executor:
        box = al.foreign.BlackBox(boxes.smooth, executor=executor)
        assert_same(al.expand(box, TWO, ORDER), directly())


def test_a_system_as_a_model_gives_the_same_bits():
    def doubled(model):
        assert isinstance(model.rate, float)
        return 2.0 * model.rate

    decay = Decay(al.Normal(1.0, 0.1))
    found = al.expand(al.foreign.BlackBox(doubled), decay)
    np.testing.assert_array_equal(found.coefficients, al.expand(doubled, decay, traced=False).coefficients)


@pytest.mark.parametrize(
    "expansion",
    [
        al.Expansion(index_set=al.index_sets.Adaptive(error=1e-4)),
        al.Expansion(4, fit=al.fits.Sparse()),
        al.Expansion(3, points=al.points.GaussPoints(), fit=al.fits.Projection()),
    ],
)
def test_outputs_may_choose_terms_and_points(expansion):
    counted = Counted()
    expanded = al.expand(al.foreign.BlackBox(counted), TWO, expansion)
    assert_same(expanded, directly(expansion=expansion))
    assert counted.calls == len(expanded.collocation.points)


def test_elements_take_boxes():
    def kinked(at):
        return abs(at["x"]) + at["z"]

    wish = al.MultiElement(order=2, error=1e-2)
    found = al.expand(al.foreign.BlackBox(kinked), TWO, wish)
    np.testing.assert_array_equal(found.coefficients, al.expand(kinked, TWO, wish, traced=False).coefficients)


def test_random_samples_are_those_of_the_function():
    box = al.foreign.BlackBox(boxes.smooth)
    for method in (al.references.monte_carlo, al.references.quasi_monte_carlo):
        found = method(box, TWO, 64, seed=3).values
        plain = method(boxes.smooth, TWO, 64, seed=3, traced=False).values
        np.testing.assert_array_equal(found["v"], plain["v"])


# --- Samples that fail -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (None, "returns nothing"),
        ({}, "no outputs"),
        ({"y": 1j, "v": np.zeros(3)}, "complex"),
        ({"y": np.nan, "v": np.zeros(3)}, "output 'y' is nan"),
        ({"y": 1.0, "v": np.array([0.0, np.inf, 0.0])}, "output 'v' is inf"),
        ({"y": 1.0}, "'y' of shape (), where sample 1 had 'v' of shape (3,), 'y' of shape ()"),
    ],
)
def test_nonsense_is_refused_by_sample_and_inputs(value, said):
    message = refused(al.foreign.BlackBox(odd(value)))
    assert said in message
    assert re.search(r"failed at sample 30 \(x=0\.9\d*, z=[\d.]+\)", message)
    assert "Finished samples are kept by this box (29)" in message


def test_an_input_that_there_is_not_ends_at_once_whatever_may_be_dropped():
    counted = Counted(lambda at: at["w"])
    assert "asks for the input 'w'" in refused(al.foreign.BlackBox(counted, drop=0.4, retries=3), kind=al.ProblemError)
    assert counted.calls == 1


def test_a_key_that_the_function_itself_lacks_fails_one_sample_alone():
    def looked_up(at):
        return {True: boxes.smooth(at)}[at["x"] < 0.95]

    assert "it raised KeyError: False" in refused(al.foreign.BlackBox(looked_up))
    with pytest.warns(al.SimulationWarning, match="1 of 30 samples"):
        al.expand(al.foreign.BlackBox(looked_up, drop=0.05), TWO, ORDER)


def test_a_sample_that_fails_once_is_run_again():
    seen = set()

    def moody(at):
        if at["x"] not in seen:
            seen.add(at["x"])
            raise OSError("no licence")
        return boxes.smooth(at)

    counted = Counted(moody)
    assert_same(al.expand(al.foreign.BlackBox(counted, retries=1), TWO, ORDER), directly())
    assert counted.calls == 2 * 30
    seen.clear()
    assert "OSError: no licence" in refused(al.foreign.BlackBox(moody))


def test_dropped_samples_leave_least_squares_at_the_others_and_a_warning_of_the_bias():
    message = refused(al.foreign.BlackBox(boxes.stiff, drop=0.03), expansion=al.Expansion(order=4))
    assert "2 of 45 samples failed, and drop=0.03 allows 1: 'stiff' failed at sample" in message
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
    assert message.startswith(f"{missing} of 45 samples of 'stiff' failed and were dropped")
    assert f"where {missing} of {missing} samples failed" in message
    assert "x from 0.7" in message
    assert "may be biased" in message
    # The least squares of the others, computed independently.
    np.testing.assert_array_equal(expanded.collocation.points, points[kept])
    matrix, values = np.asarray(full.collocation.matrix)[kept], np.asarray(full.samples["y"])[kept]
    np.testing.assert_allclose(expanded.coefficients["y"], np.linalg.lstsq(matrix, values)[0], rtol=1e-11, atol=1e-13)


def test_a_random_sample_without_the_corner_is_biased_as_the_warning_says():
    with pytest.warns(al.SimulationWarning, match=r"where (\d+) of \1 samples failed\. Statistics may be biased"):
        sampled = al.references.monte_carlo(al.foreign.BlackBox(boxes.stiff, drop=0.1), TWO, 400)
    # The mean over what is left of the square: without the corner x > 0.7, z > 2.5, of probability 0.15 * 0.25.
    corner = (np.e - np.exp(0.7)) / 2 * (9.0 - 2.5**2) / 4
    biased = (2 * np.sinh(1.0) - corner) / (1 - 0.15 * 0.25)
    mean = sampled["y"].mean
    assert abs(mean.value - biased) < 4 * mean.standard_error
    assert sampled.samples < 400


def test_too_large_a_hole_is_refused_by_the_condition_number():
    def narrow(at):
        if at["x"] > 0.4:
            raise ValueError("no convergence")
        return boxes.smooth(at)

    box = al.foreign.BlackBox(narrow, drop=0.4)
    with pytest.warns(al.SimulationWarning, match="may be biased"):
        message = refused(box, kind=al.ProblemError, expansion=al.Expansion(order=6))
    assert re.search(r"condition number of least squares from [\d.]+ to \d+", message)


@pytest.mark.parametrize(
    "method",
    [
        lambda box: al.expand(box, TWO, al.Expansion(index_set=al.index_sets.Adaptive(error=1e-4))),
        lambda box: al.expand(box, TWO, al.MultiElement(order=2)),
        lambda box: al.references.quasi_monte_carlo(box, TWO, 64),
    ],
)
def test_methods_that_need_every_sample_drop_none(method):
    with pytest.raises(al.SimulationError, match="needs every sample, so that none is dropped"):
        method(al.foreign.BlackBox(odd(None), drop=0.4))


def test_interpolation_needs_every_sample():
    expansion = al.Expansion(2, points=al.points.OptimalPoints(), fit=al.fits.Interpolation())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", al.SimulationWarning)
        assert "Interpolation needs all" in refused(
            al.foreign.BlackBox(boxes.stiff, drop=0.49), kind=al.ProblemError, expansion=expansion
        )


def test_statistics_of_a_box_have_no_derivatives():
    def spread(half_width):
        return al.expand(al.foreign.BlackBox(lambda at: at["x"]), {"x": al.Uniform(0.0, half_width=half_width)}).std

    with pytest.raises(al.ProblemError, match="is a black box, so nothing can be differentiated"):
        jax.grad(spread)(0.1)
    for method in (al.references.linearise, al.references.second_order):
        with pytest.raises(al.ProblemError, match="a black box has no derivatives"):
            method(al.foreign.BlackBox(boxes.smooth), TWO)


def test_a_function_may_change_what_it_is_given():
    def moody(at):
        first = at["x"] not in seen
        seen.add(at["x"])
        at["x"] = at["x"] + 1.0
        at["table"] += 1.0
        if first:
            raise OSError("no licence")
        return at["x"] + at["table"].sum()

    seen = set()
    model = TWO | {"table": np.zeros(2)}
    found = al.expand(al.foreign.BlackBox(moody, retries=1), model, ORDER)
    assert float(found.mean) == pytest.approx(3.0)
    assert float(found.std) == pytest.approx(1 / np.sqrt(3))


@pytest.mark.parametrize("function", [al.foreign.Command(["program", "{x}", "{z}"]), al.foreign.Isolated(boxes.smooth)])
def test_what_leaves_this_process_is_not_traced_and_says_so(function):
    with pytest.raises(al.ProblemError, match=r"wrap it, al\.foreign\.BlackBox\((Command|Isolated)"):
        al.expand(function, TWO)
