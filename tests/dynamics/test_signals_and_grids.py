import jax
import numpy as np
import pytest
from scipy import integrate

import aleator as al
from aleator._core.arrays import numbers_to_arrays
from aleator.uncertainty import at_means, named_numbers, placements, realise
from compiling import compiled


@pytest.fixture
def table(tmp_path):
    def write(text, encoding="utf-8"):
        path = tmp_path / "road.csv"
        path.write_text(text, encoding=encoding)
        return path

    return write


def test_a_table_is_linear_between_its_samples():
    signal = al.Tabulated(np.array([0.0, 1.0, 3.0]), np.array([2.0, 4.0, -2.0]))
    assert np.asarray(signal.sampled(np.array([0.25, 2.5]) / 3.0, 0.0, 3.0)) == pytest.approx([2.5, -0.5])
    assert signal.span() == (0.0, 3.0)


def test_a_table_is_read_from_named_columns_of_a_file_with_comments(table):
    text = "height,t_s,other\n# a comment\n0.5,0.0,a\n0.75,0.1,b\n# another\n-1.0,0.4,c\n"
    path = table(text, encoding="utf-8-sig")
    signal = al.Tabulated.from_csv(path, time="t_s", value="height")
    np.testing.assert_array_equal(signal.times, [0.0, 0.1, 0.4])
    np.testing.assert_array_equal(signal.values, [0.5, 0.75, -1.0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,height\n0,1\n1,2\n", r"road\.csv: expected one column 'z'; received \['t', 'height'\]"),
        ("t,z\n0,1\n2,1\n1,1\n", r"road\.csv.*times must increase, but sample 2 is not after"),
        ("t,z\n0,1\n1,inf\n", r"road\.csv.*values: expected finite numbers; received inf at t = 1 s"),
        ("t,z\n0,1\n1,high\n", r"road\.csv: row 2.*'high'"),
        ("t;z\n0;1\n1;2\n", r"road\.csv: expected commas between columns.*received semicolons"),
        ("", r"road\.csv"),
    ],
)
def test_a_file_that_is_no_table_is_refused_by_name(table, text, message):
    with pytest.raises(al.ProblemError, match=message):
        al.Tabulated.from_csv(table(text), time="t", value="z")


def test_a_file_that_is_not_there_or_no_text_is_refused_by_name(tmp_path):
    with pytest.raises(al.ProblemError, match=r"road\.csv"):
        al.Tabulated.from_csv(tmp_path / "road.csv", time="t", value="z")
    (tmp_path / "road.csv").write_bytes(b"t,z\n0,1\n1,\xb0\n")
    with pytest.raises(al.ProblemError, match=r"road\.csv: expected text in UTF-8; received the byte 0xb0"):
        al.Tabulated.from_csv(tmp_path / "road.csv", time="t", value="z")


@pytest.mark.parametrize(
    ("times", "values", "message"),
    [
        ([0.0, 1.0], [1.0, 2.0, 3.0], r"times \(2,\) and values \(3,\)"),
        (
            [0.0, 1.0],
            [al.Decision(np.zeros(2), -1, 1), 1.0],
            r"values: expected numbers that form an array; received parts of the shapes \[\(\), \(2,\)\]",
        ),
        (
            [0.0, 1.0],
            [al.Decision(0.0, -1, 1), "high"],
            "values: expected numbers, distributions or decisions; received 'high'",
        ),
    ],
    ids=lambda value: str(value)[:40],
)
def test_a_table_whose_times_and_values_do_not_fit_is_refused(times, values, message):
    with pytest.raises(al.ProblemError, match=message):
        al.Tabulated(times, values)


def test_a_tables_values_may_mix_numbers_distributions_and_decisions():
    values = [al.Uniform(1.0, half_width=0.5), 2, al.Decision(4.0, 0, 9)]
    model = numbers_to_arrays({"u": al.Tabulated([0.0, 1.0, 3.0], values)})
    assert tuple(placements(model).distributions) == ("u.values.0",)
    assert tuple(placements(model).decisions) == ("u.values.2",)
    assert float(named_numbers(model, np.array([4.0]))["u.values.1"]) == 2.0
    signal = realise(model, np.array([1.0]), np.array([6.0]))["u"]
    times = np.array([0.0, 0.5, 2.0])
    assert compiled(jax.vmap(signal))(times).tolist() == [1.5, 1.75, 4.0]
    held = realise(at_means(model), np.zeros(0), np.array([6.0]))["u"]
    assert compiled(jax.vmap(held))(times).tolist()[0] == 1.0


def test_a_grid_knows_its_instants_and_simpsons_rule():
    grid = al.Grid(3.0, 8, t_start=1.0)
    np.testing.assert_allclose(grid.times, np.linspace(1.0, 3.0, 9), rtol=1e-15)
    assert grid.step == 0.25
    values = np.sin(np.linspace(1.0, 3.0, 17))
    assert float(grid.node_weights @ values) == pytest.approx(integrate.simpson(values, dx=0.125), rel=1e-14)


@pytest.mark.parametrize(
    ("end", "start"),
    [
        (0.0, 0.0),
        (1.0, -np.inf),
        (al.Decision(2.0, 0.0, 3.0), 0.0),
    ],
)
def test_a_grid_that_does_not_end_after_its_start_is_refused(end, start):
    with pytest.raises(al.ProblemError, match=r"Grid: t_(start|final): expected .* received "):
        al.Grid(end, 10, start)


class Pushed(al.System):
    states = ("x", "v")
    push: al.Number

    def rhs(self, t, z):
        return z.v, self.push

    def outputs(self, t, z):
        return {"x": z.x}


def test_a_signal_in_the_place_of_a_number_is_told_to_be_given_as_an_input():
    with pytest.raises(al.ProblemError, match=r"Tabulated.*inputs=\{'push': ...\}"):
        al.simulate(Pushed(push=al.Tabulated([0.0, 1.0], [0.0, 1.0])), al.Grid(1.0, 10))
