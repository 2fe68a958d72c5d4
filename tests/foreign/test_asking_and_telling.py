"""Points that are asked and told, against the same functions expanded directly, bit by bit."""

import csv
import subprocess
import sys
import warnings

import numpy as np
import pytest
import sklearn  # noqa: F401  it sets variables of the environment when it is first imported
import xarray

import aleator as al
import black_boxes as boxes
from aleator.foreign._responses import answers

TWO = {"x": al.Uniform.bounds(-1.0, 1.0), "z": al.Normal(2.0, 0.1)}
ORDER = al.Expansion(order=3)


def respond(points, function=boxes.smooth):
    """The outputs at a table of points: a dict of arrays with a row for each."""
    rows = [function(dict(zip(points, map(float, row), strict=True))) for row in zip(*points.values(), strict=True)]
    return {name: np.stack([row[name] for row in rows]) for name in rows[0]}


@pytest.fixture(scope="module")
def asked():
    return al.foreign.ask(TWO, ORDER)


@pytest.fixture(scope="module")
def direct():
    return al.expand(boxes.smooth, TWO, ORDER, traced=False)


def assert_same(told, direct):
    for name, coefficients in direct.coefficients.items():
        np.testing.assert_array_equal(told.coefficients[name], coefficients)
    np.testing.assert_array_equal(told.collocation.points, direct.collocation.points)


def test_arrays_that_are_told_give_the_bits_of_the_function(asked, direct):
    assert_same(asked.tell(respond(asked.points)), direct)
    assert str(asked).startswith("30 samples of x, z\n  x: -0.9")
    with pytest.raises(ValueError, match="read-only"):
        asked.points["x"][0] = 0.0


def test_one_array_without_a_name_is_one_output(asked):
    told = asked.tell(respond(asked.points)["y"])
    direct = al.expand(lambda at: boxes.smooth(at)["y"], TWO, ORDER, traced=False)
    np.testing.assert_array_equal(told.coefficients, direct.coefficients)


@pytest.mark.parametrize(
    ("model", "expansion"),
    [
        (al.correlated(TWO, {("x", "z"): 0.5}), al.Expansion(3, tolerance=0.2)),
        (TWO, al.Expansion(4, fit=al.fits.Sparse())),
        ({"x": al.Uniform(al.Decision(0.2, 0.0, 1.0), half_width=0.1), "z": al.Normal(2.0, 0.1)}, None),
        ({"x": al.Uniform.bounds(-1.0, 1.0), "z": 2.0}, ORDER),
    ],
)
def test_what_is_asked_is_what_expand_would_evaluate(model, expansion):
    asked = al.foreign.ask(model, expansion)
    constant = {"z": 2.0} if set(asked.points) == {"x"} else {}
    told = asked.tell(respond(asked.points, lambda at: boxes.smooth(at | constant)))
    assert_same(told, al.expand(boxes.smooth, model, expansion, traced=False))


# --- Tables ----------------------------------------------------------------------------------------------------------

WRITER = """
import aleator as al
two = {"x": al.Uniform.bounds(-1.0, 1.0), "z": al.Normal(2.0, 0.1)}
al.foreign.ask(two, al.Expansion(order=3)).write_csv("points.csv")
"""


def written(path, asked, change=lambda table: table, function=boxes.smooth):
    """A table of points as it was written, with columns of outputs, changed in some way."""
    asked.write_csv(path)
    answered(path, change, function)


def answered(path, change=lambda table: table, function=boxes.smooth):
    with path.open() as file:
        table = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    for row in table:
        outputs = function({"x": row["x"], "z": row["z"]})
        row |= {"y": float(outputs["y"])} | {f"v[{i}]": float(value) for i, value in enumerate(outputs["v"])}
    table = change(table)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(table[0]))
        writer.writeheader()
        writer.writerows(table)


@pytest.mark.slow
def test_a_table_asked_by_another_process_gives_the_same_bits(tmp_path, asked, direct):
    subprocess.run([sys.executable, "-c", WRITER], cwd=tmp_path, check=True)
    answered(tmp_path / "points.csv")
    assert_same(asked.tell(tmp_path / "points.csv"), direct)


def test_a_dataset_gives_the_same_bits_after_netcdf_too(tmp_path, asked, direct):
    dataset = asked.dataset
    outputs = respond({name: dataset[name].values for name in TWO})
    dataset["y"], dataset["v"] = ("sample", outputs["y"]), (("entry", "sample"), outputs["v"].T)
    dataset.to_netcdf(tmp_path / "responses.nc")
    for one in (dataset, xarray.load_dataset(tmp_path / "responses.nc"), dataset.isel(sample=slice(None, None, -1))):
        assert_same(asked.tell(one), direct)


def test_rows_are_recognised_by_their_numbers_in_any_order(tmp_path, asked, direct):
    written(tmp_path / "table.csv", asked, lambda table: sorted(table, key=lambda row: row["z"]))
    assert_same(asked.tell(tmp_path / "table.csv"), direct)
    order = np.random.default_rng(0).permutation(len(asked))
    told = {name: values[order] for name, values in respond(asked.points).items()}
    assert_same(asked.tell(told | {"sample": order + 1}), direct)


@pytest.mark.parametrize("digits", [15, 6])
def test_inputs_rounded_as_in_a_spreadsheet_or_to_six_digits_are_the_same(tmp_path, asked, digits):
    def rounded(table):
        return [row | {name: float(f"{row[name]:.{digits}g}") for name in TWO} for row in table]

    written(tmp_path / "table.csv", asked, rounded)
    told = asked.tell(tmp_path / "table.csv")
    # The outputs in the table are those at all digits.
    assert_same(told, al.expand(boxes.smooth, TWO, ORDER, traced=False))
    written(tmp_path / "table.csv", asked, lambda table: [row | {"x": float(f"{row['x']:.3g}")} for row in table])
    with pytest.raises(al.ProblemError, match="points changed or rows reordered"):
        asked.tell(tmp_path / "table.csv")


@pytest.mark.parametrize("digits", [9, 6])
def test_rounded_inputs_that_are_hardly_uncertain_are_refused(tmp_path, digits):
    narrow = al.foreign.ask({"x": al.Normal(1000.0, 10.0 ** (2 - digits))}, al.Expansion(order=2))
    rows = [(i, f"{x:.{digits}g}", x) for i, x in enumerate(narrow.points["x"], 1)]
    (tmp_path / "table.csv").write_text("\n".join(["sample,x,y", *(f"{i},{x},{y}" for i, x, y in rows)]))
    with pytest.raises(al.ProblemError, match=r"points changed or rows reordered|fit another sample too"):
        narrow.tell(tmp_path / "table.csv")


def test_rounded_inputs_that_fit_two_samples_are_refused():
    points = {"x": np.array([0.0, 1.0, 1.000004, 0.005])}
    named = {"sample": np.arange(1.0, 5.0), "x": np.array([0.0, 1.000002, 1.000004, 0.005]), "y": np.ones(4)}
    with pytest.raises(al.ProblemError, match="those of sample 2 are rounded so that they fit another sample too"):
        answers(points, named)
    assert len(answers(points, named | {"x": points["x"]})) == 4


@pytest.mark.parametrize("texts", [["", "pump was cold"], ["1", "see page 2"]])
def test_a_column_of_comments_is_left_aside(tmp_path, asked, direct, texts):
    def commented(table):
        return [row | {"Comment": texts[i % 2]} for i, row in enumerate(table)]

    written(tmp_path / "table.csv", asked, commented)
    assert_same(asked.tell(tmp_path / "table.csv"), direct)
    assert set(asked.tell(tmp_path / "table.csv").coefficients) == {"y", "v"}


def renumbered(table):
    return [row | {"sample": i} for i, row in enumerate(sorted(table, key=lambda row: row["x"] * row["z"]), 1)]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda table: [*table[:4], table[4] | {"z": 2.01}, *table[5:]],
            "at sample 5, as asked; received 2.01 (1 of 30 rows differ)",
        ),
        (renumbered, "points changed or rows reordered"),
        (lambda table: [*table, table[3]], "sample 4 has 2 rows"),
        (lambda table: [row | {"sample": 1.5} for row in table], "samples from 1 to 30; received 1.5"),
        (lambda table: [{k: v for k, v in row.items() if k != "sample"} for row in table], "['sample'] are missing"),
        (lambda table: [{k: v for k, v in row.items() if k != "x"} for row in table], "['x'] are missing"),
        (lambda table: [{k: v for k, v in row.items() if k in "samplexz"} for row in table], "expected an output"),
        (lambda table: [{k: v for k, v in row.items() if k != "v[1]"} for row in table], "expected v[1] next"),
        (lambda table: [row | {"y": "fast"} for row in table], "expected numbers in the column 'y'"),
    ],
)
def test_a_table_whose_points_are_not_those_asked_is_refused(tmp_path, asked, change, said):
    written(tmp_path / "table.csv", asked, change)
    with pytest.raises(al.ProblemError) as caught:
        asked.tell(tmp_path / "table.csv")
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("responses", "said"),
    [
        ({"y": np.zeros(29)}, "expected 30 rows.*received 29 rows"),
        ({"y": np.zeros(30), "w": np.zeros(29)}, "received 29 and 30 rows"),
        ({"y": 1.0}, "with a row for each sample"),
        ({"x": np.zeros(30)}, "expected an output besides"),
        ({"y": np.zeros(30), "x": np.zeros(30)}, "expected x = "),
    ],
)
def test_responses_of_the_wrong_form_are_refused(asked, responses, said):
    with pytest.raises(al.ProblemError, match=said):
        asked.tell(responses)


# --- Missing rows ----------------------------------------------------------------------------------------------------


def emptied(table):
    """The first row missing, and the second without outputs."""
    return [table[1] | {name: "" for name in table[1] if name in "y" or "[" in name}, *table[2:]]


def test_a_missing_response_is_refused_by_sample_and_inputs(tmp_path, asked):
    written(tmp_path / "table.csv", asked, emptied)
    with pytest.raises(al.SimulationError, match=r"2 of 30 samples .* allows 0: first sample 1 \(x=.*no response"):
        asked.tell(tmp_path / "table.csv")


def test_missing_rows_leave_the_least_squares_that_a_box_would_have(tmp_path, asked):
    path = tmp_path / "table.csv"
    written(path, asked, emptied)
    first = {float(values) for values in asked.points["x"][:2]}

    def failing(at):
        if at["x"] in first:
            raise ValueError("lost")
        return boxes.smooth(at)

    with pytest.warns(al.SimulationWarning, match="2 of 30 samples .* first sample 1 .* it has no response"):
        told = asked.tell(path, drop=0.1)
    with pytest.warns(al.SimulationWarning, match="2 of 30 samples of 'failing'"):
        direct = al.expand(al.foreign.BlackBox(failing, drop=0.1), TWO, ORDER)
    assert len(told.collocation.points) == 28
    assert_same(told, direct)


def test_a_response_that_is_not_finite_is_missing(asked):
    responses = respond(asked.points)
    responses["v"][4, 1] = np.nan
    with pytest.raises(al.SimulationError, match=r"first sample 5 \(x=.*output 'v' is nan"):
        asked.tell(responses)
    with pytest.warns(al.SimulationWarning, match="output 'v' is nan"):
        assert len(asked.tell(responses, drop=0.05).collocation.points) == 29


def test_too_few_responses_are_refused(asked):
    responses = {name: values[:16] for name, values in respond(asked.points).items()} | {"sample": np.arange(1, 17)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", al.SimulationWarning)
        with pytest.raises(al.ProblemError, match="condition number of least squares"):
            asked.tell(responses, drop=0.49)


def test_a_wholly_determined_expansion_has_no_point_to_lose():
    asked = al.foreign.ask(TWO, al.Expansion(1, points=3))
    responses = respond(asked.points)["y"]
    responses[1] = np.nan
    with (
        pytest.warns(al.SimulationWarning),
        pytest.raises(al.ProblemError, match="1 of 3 samples are missing, and 2 do not determine 3 terms"),
    ):
        asked.tell(responses, drop=0.4)


@pytest.mark.parametrize(
    ("model", "expansion", "said"),
    [
        (TWO, al.Expansion(index_set=al.index_sets.Adaptive()), "Adaptive chooses its points"),
        (TWO, al.MultiElement(), "expected an Expansion"),
        ({"x": 1.0}, None, "expected distributions in it"),
    ],
)
def test_points_that_depend_on_outputs_cannot_be_asked_beforehand(model, expansion, said):
    with pytest.raises(al.ProblemError, match=said):
        al.foreign.ask(model, expansion)
