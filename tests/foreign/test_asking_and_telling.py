"""Points that are asked and told, against the same functions expanded directly, bit by bit."""

import csv

import numpy as np
import pytest
import xarray
from boxed_functions import assert_same

import aleator as al
import black_boxes as boxes
from zoo import cases

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


def test_arrays_that_are_told_give_the_bits_of_the_function(asked, direct):
    assert_same(asked.tell(respond(asked.points)), direct)
    with pytest.raises(ValueError, match="read-only"):
        asked.points["x"][0] = 0.0


@pytest.mark.parametrize(
    ("model", "expansion"),
    cases(
        [
            (al.correlated(TWO, {("x", "z"): 0.5}), al.Expansion(3, tolerance=0.2)),
            (TWO, al.Expansion(4, fit=al.fits.Sparse())),
            ({"x": al.Uniform.bounds(-1.0, 1.0), "z": 2.0}, ORDER),
        ]
    ),
)
def test_what_is_asked_is_what_expand_would_evaluate(model, expansion):
    asked = al.foreign.ask(model, expansion)
    constant = {"z": 2.0} if set(asked.points) == {"x"} else {}
    told = asked.tell(respond(asked.points, lambda at: boxes.smooth(at | constant)))
    assert_same(told, al.expand(boxes.smooth, model, expansion, traced=False))


# --- Tables ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def tell(tmp_path, asked):
    """Tells a table of the points as it was written, with columns of outputs, changed in some way."""

    def told(change, **options):
        asked.write_csv(tmp_path / "table.csv")
        with (tmp_path / "table.csv").open() as file:
            table = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
        for row in table:
            outputs = boxes.smooth({"x": row["x"], "z": row["z"]})
            row |= {"y": float(outputs["y"])} | {f"v[{i}]": float(value) for i, value in enumerate(outputs["v"])}
        table = change(table)
        with (tmp_path / "table.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, list(table[0]))
            writer.writeheader()
            writer.writerows(table)
        return asked.tell(tmp_path / "table.csv", **options)

    return told


def rounded(table, digits=6):
    return [row | {name: float(f"{row[name]:.{digits}g}") for name in TWO} for row in table]


def commented(table):
    return [row | {"Comment": ["1", "see page 2"][i % 2]} for i, row in enumerate(table)]


@pytest.mark.parametrize("change", [lambda table: sorted(table, key=lambda row: row["z"]), rounded, commented])
def test_rows_are_recognised_in_any_order_rounded_to_six_digits_and_beside_comments(tell, direct, change):
    # The outputs of rounded inputs are those at all digits.
    assert_same(tell(change), direct)


def test_a_dataset_gives_the_same_bits_after_netcdf_too(tmp_path, asked, direct):
    dataset = asked.dataset
    outputs = respond({name: dataset[name].values for name in TWO})
    dataset["y"], dataset["v"] = ("sample", outputs["y"]), (("entry", "sample"), outputs["v"].T)
    dataset.to_netcdf(tmp_path / "responses.nc")
    for one in (dataset, xarray.load_dataset(tmp_path / "responses.nc"), dataset.isel(sample=slice(None, None, -1))):
        assert_same(asked.tell(one), direct)


def renumbered(table):
    return [row | {"sample": i} for i, row in enumerate(sorted(table, key=lambda row: row["x"] * row["z"]), 1)]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda table: [*table[:4], table[4] | {"z": 2.01}, *table[5:]],
            "at sample 5, as asked; received 2.01 (1 of 32 rows differ)",
        ),
        (renumbered, "points changed or rows reordered"),
        (lambda table: [*table, table[3]], "from 1 to 32, each once; received [4.0]"),
        (lambda table: [{k: v for k, v in row.items() if k != "sample"} for row in table], "['sample'] are missing"),
        (
            lambda table: [*table[:4], table[4] | {"y": "NA"}, *table[5:]],
            "row 5: could not convert string to float: 'NA'",
        ),
    ],
)
def test_a_table_whose_points_are_not_those_asked_is_refused(tell, change, said):
    with pytest.raises(al.ProblemError) as caught:
        tell(change)
    assert said in str(caught.value)


# --- Missing rows ----------------------------------------------------------------------------------------------------


def emptied(table):
    """The first row missing, and the second without outputs."""
    return [table[1] | {name: "" for name in table[1] if name in "y" or "[" in name}, *table[2:]]


def test_missing_rows_leave_the_least_squares_that_a_box_would_have(tell, asked):
    first = {float(values) for values in asked.points["x"][:2]}

    def failing(at):
        if at["x"] in first:
            raise ValueError("lost")
        return boxes.smooth(at)

    with pytest.raises(al.SimulationError, match=r"'the model' failed at sample 1 \(x=.*no response"):
        tell(emptied)
    with pytest.warns(al.SimulationWarning, match="2 of 32 samples .* first sample 1 .* it has no response"):
        told = tell(emptied, drop=0.1)
    with pytest.warns(al.SimulationWarning, match="2 of 32 samples of 'failing'"):
        direct = al.expand(al.foreign.BlackBox(failing, drop=0.1), TWO, ORDER)
    assert len(told.collocation.points) == 28
    assert_same(told, direct)


def test_a_response_that_is_not_finite_is_missing(asked):
    responses = respond(asked.points)
    responses["v"][4, 1] = np.nan
    with pytest.raises(al.SimulationError, match=r"failed at sample 5 \(x=.*output 'v' is nan"):
        asked.tell(responses)
    with pytest.warns(al.SimulationWarning, match="output 'v' is nan"):
        assert len(asked.tell(responses, drop=0.05).collocation.points) == 29
