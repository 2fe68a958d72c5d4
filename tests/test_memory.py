"""What would not fit into memory is refused by a count, before it is asked for."""

import resource
import sys

import numpy as np
import pytest

import aleator as al
from aleator._core import memory
from aleator.expansion import Basis, collocate
from aleator.uncertainty import LegendreGerm
from zoo import Decay

HUGE = 10**9


def germs(variables):
    return {f"w{i}": LegendreGerm() for i in range(variables)}


EXPANSIONS = {
    "thirty variables at order four": (30, al.Expansion(4)),
    "a total degree of a billion": (1, al.Expansion(HUGE)),
    "a total degree of a billion in many variables": (100, al.Expansion(HUGE)),
    "a tensor product": (100, al.Expansion(HUGE, index_set=al.index_sets.TensorProduct())),
    "powers alone": (5, al.Expansion(HUGE, index_set=al.index_sets.HyperbolicCross())),
    "weighted powers": (5, al.Expansion(HUGE, index_set=al.index_sets.Anisotropic([1.0] * 5))),
    "a weight of nearly nothing": (2, al.Expansion(3, index_set=al.index_sets.Anisotropic([1e-320, 1.0]))),
    "a billion points": (5, al.Expansion(3, points=HUGE)),
    "a trillion points": (5, al.Expansion(3, points=al.points.SobolPoints(HUGE * 1000))),
    "candidates of optimal points": (5, al.Expansion(3, points=al.points.OptimalPoints(HUGE))),
    "a full grid": (8, al.Expansion(3, points=al.points.GaussPoints(HUGE), fit=al.fits.Projection())),
    "a rule of a million roots": (1, al.Expansion(3, points=al.points.GaussPoints(10**6), fit=al.fits.Projection())),
    "a sparse grid": (8, al.Expansion(3, points=al.points.SmolyakPoints(HUGE), fit=al.fits.Projection())),
    "a sparse grid of one variable": (
        1,
        al.Expansion(3, points=al.points.SmolyakPoints(100_000), fit=al.fits.Projection()),
    ),
    "candidates of a sparse expansion": (60, al.Expansion(4, points=10**5, fit=al.fits.Sparse())),
}


@pytest.mark.parametrize("name", EXPANSIONS)
def test_an_expansion_that_does_not_fit_is_refused_by_its_count(name, monkeypatch):
    """Had it been enumerated, this would never end."""
    monkeypatch.setattr(memory, "memory", lambda: 16 * 2**30)
    variables, expansion = EXPANSIONS[name]
    with pytest.raises(al.ProblemError, match=r"GiB|more than"):
        collocate(germs(variables), expansion)


def test_thirty_variables_at_order_four_say_how_much_they_need_and_what_to_do(monkeypatch):
    monkeypatch.setattr(memory, "memory", lambda: 16 * 2**30)
    # (30 + 4)! / (30! 4!) terms at three times as many points, seven matrices of eight-byte numbers.
    needed = 7 * 8 * 3 * 46_376**2 / 2**30
    with pytest.raises(al.ProblemError, match=rf"{needed:.3g} GiB of memory; this machine has 16 GiB.*HyperbolicCross"):
        collocate(germs(30), al.Expansion(4))


def test_the_same_expansion_is_made_where_there_is_room_for_it(monkeypatch):
    monkeypatch.setattr(memory, "memory", lambda: 100_000)
    with pytest.raises(al.ProblemError, match="GiB"):
        collocate(germs(3), al.Expansion(3))
    monkeypatch.setattr(memory, "memory", lambda: 1_000_000)
    assert collocate(germs(3), al.Expansion(3)).basis.terms == 20


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the peak of memory is read as on Linux")
def test_what_is_counted_is_what_a_collocation_takes():
    collocate(germs(3), al.Expansion(3))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    found = collocate(germs(4), al.Expansion(10)).collocation
    taken = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    assert 0.3 * taken < 7 * 8 * found.matrix.size


def test_a_matrix_at_any_points_is_counted_first(monkeypatch):
    basis = Basis(germs(2), np.zeros((1, 2), dtype=int))
    monkeypatch.setattr(memory, "memory", lambda: 1000)
    with pytest.raises(al.ProblemError, match="1 terms in 2 variables at 40 points"):
        basis.matrix(np.zeros((40, 2)))


@pytest.mark.parametrize(
    "verb", [al.references.monte_carlo, al.references.quasi_monte_carlo, al.references.sobol_indices]
)
def test_a_sample_that_does_not_fit_is_refused(verb):
    with pytest.raises(al.ProblemError, match=rf"{verb.__name__}: .* samples of 1 variables would need .* GiB|GiB"):
        verb(lambda at: at["w"], {"w": al.Uniform.bounds(0.0, 1.0)}, 2**50)


def decay(steps):
    return al.Problem(
        Decay(rate=al.Uniform(al.Decision(1.0, 0.5, 2.0), half_width=0.1)),
        grid=al.Grid(1.0, steps=steps),
        minimize=al.terminal("x").mean,
        subject_to=[al.path("x").at_most(2.0)],
        expansion=al.Expansion(3),
    )


def test_a_solve_whose_histories_do_not_fit_is_refused(monkeypatch):
    # 12 points, 10 001 instants, one output with its derivative by one decision.
    needed = 12 * 10_001 * 2 * 8
    monkeypatch.setattr(memory, "memory", lambda: int(1.9 * needed))
    with pytest.raises(al.ProblemError, match=r"12 systems with 1 outputs at 10001 instants .* by 1 decisions"):
        al.solve(decay(10_000))


def test_evidence_that_does_not_fit_is_refused(monkeypatch):
    solution = al.solve(decay(10))
    with pytest.raises(al.ProblemError, match=r"systems would need .* GiB"):
        al.validate(solution, 10**15)
    monkeypatch.setattr(memory, "memory", lambda: 10**6)
    with pytest.raises(al.ProblemError, match="Take a smaller batch"):
        al.validate(solution, 10_000, batch=10_000)
    assert al.validate(solution, 10_000, batch=100).samples == 10_000


def groups(tmp_path, monkeypatch, own, **limits):
    (tmp_path / "own").write_text(own)
    for place, limit in limits.items():
        file = tmp_path / place.replace("__", "/") / "memory.max"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(limit)
    monkeypatch.setattr(memory, "_GROUPS", tmp_path)
    monkeypatch.setattr(memory, "_OWN_GROUP", tmp_path / "own")
    return memory.memory.__wrapped__()


def test_the_limit_of_a_container_counts(tmp_path, monkeypatch):
    whole = groups(tmp_path, monkeypatch, "0::/\n")
    assert whole > 2**28
    assert groups(tmp_path, monkeypatch, "0::/a/b\n", a="100000\n", a__b="max\n") == 100_000
    assert groups(tmp_path, monkeypatch, "0::/a/b\n", a__b="50000\n") == 50_000
    assert groups(tmp_path, monkeypatch, "0::/c\n") == whole
    assert groups(tmp_path, monkeypatch, "1:name=old:/\n") == whole
