"""What would not fit into memory is refused by a count, before it is asked for."""

import jax.numpy as jnp
import pytest

import aleator as al
from aleator._core import arrays
from aleator.expansion import collocate
from aleator.uncertainty import LegendreGerm
from zoo import Decay

HUGE = 10**9


def germs(variables):
    return {f"w{i}": LegendreGerm() for i in range(variables)}


def projection(points):
    return al.Expansion(3, points=points, fit=al.fits.Projection())


# Had one of them been enumerated, that would never end.
EXPANSIONS = {
    "thirty variables at order four": (30, al.Expansion(4)),
    "a total degree of a billion": (1, al.Expansion(HUGE)),
    "a weight of nearly nothing": (2, al.Expansion(3, index_set=al.index_sets.Anisotropic([1e-320, 1.0]))),
    "a trillion points": (5, al.Expansion(3, points=al.points.SobolPoints(HUGE * 1000))),
    "candidates of optimal points": (5, al.Expansion(3, points=al.points.OptimalPoints(HUGE))),
    "a rule of a million roots": (1, projection(al.points.GaussPoints(10**6))),
    "a sparse grid of one variable": (1, projection(al.points.SmolyakPoints(100_000))),
    "candidates of a sparse expansion": (60, al.Expansion(4, points=10**5, fit=al.fits.Sparse())),
}


@pytest.mark.parametrize("name", EXPANSIONS)
def test_an_expansion_that_does_not_fit_is_refused_by_its_count(name, monkeypatch):
    monkeypatch.setattr(arrays, "memory", lambda: 16 * 2**30)
    variables, expansion = EXPANSIONS[name]
    with pytest.raises(al.ProblemError, match=r"GiB|more than") as caught:
        collocate(germs(variables), expansion)
    if variables == 30:
        # (30 + 4)! / (30! 4!) terms at three times as many points, seven matrices of eight-byte numbers.
        assert f"{7 * 8 * 3 * 46_376**2 / 2**30:.3g} GiB of memory; this machine has 16 GiB" in str(caught.value)


@pytest.mark.parametrize(
    "verb", [al.references.monte_carlo, al.references.quasi_monte_carlo, al.references.sobol_indices]
)
def test_a_sample_that_does_not_fit_is_refused(verb):
    with pytest.raises(al.ProblemError, match="GiB"):
        verb(lambda at: at["w"], {"w": al.Uniform.bounds(0.0, 1.0)}, 2**50)


def test_a_solve_and_evidence_that_do_not_fit_are_refused(monkeypatch):
    problem = al.Problem(
        Decay(rate=al.Uniform(al.Decision(1.0, 0.5, 2.0), half_width=0.1)),
        grid=al.Grid(1.0, 10),
        minimize=al.terminal("x").mean,
        subject_to=[al.path("x").at_most(2.0)],
        expansion=al.Expansion(3),
    )
    # 12 points, 10 001 instants, one output with its derivative by one decision.
    with monkeypatch.context() as patch:
        patch.setattr(arrays, "memory", lambda: int(1.9 * 12 * 10_001 * 2 * 8))
        with pytest.raises(al.ProblemError, match=r"12 systems with 1 outputs at 10001 instants .* by 1 decisions"):
            al.solve(problem.on_grid(al.Grid(1.0, 10_000)))
    solution = al.solve(problem)
    with pytest.raises(al.ProblemError, match=r"systems would need .* GiB"):
        al.validate(solution, 10**15)
    monkeypatch.setattr(arrays, "memory", lambda: 10**6)
    with pytest.raises(al.ProblemError, match="Take a smaller batch"):
        al.validate(solution, 10_000, batch=10_000)
    assert al.validate(solution, 10_000, batch=100).samples == 10_000


@pytest.mark.parametrize("steps", [HUGE**2, 2**63, 10**400])
def test_a_grid_that_does_not_fit_is_refused_where_it_is_made(steps):
    with pytest.raises(al.ProblemError, match=r"steps would need .* GiB"):
        al.Grid(1.0, steps)


class Wide(Decay):
    """A decay with an output of many numbers."""

    def outputs(self, t, z):
        return {"x": z.x, "wide": z.x * jnp.ones(10**6)}


def test_outputs_of_many_numbers_are_counted_before_they_are_computed(monkeypatch):
    # 1e6 numbers of 8 bytes at 11 instants and twice; of the other output there is one at each.
    monkeypatch.setattr(arrays, "memory", lambda: 2 * 8 * 11 * 10**6)
    with pytest.raises(al.ProblemError, match=r"Wide: outputs of 1e\+06 numbers at 11 instants would need"):
        al.Problem(Wide(al.Decision(1.0, 0.5, 2.0)), grid=al.Grid(1.0, 10), minimize=al.terminal("x").mean)
    with pytest.raises(al.ProblemError, match=r"Wide: outputs of 1e\+06 numbers at 11 instants would need"):
        al.simulate(Wide(1.0), al.Grid(1.0, 10))
    assert set(al.simulate(Wide(1.0), al.Grid(1.0, 10), only=["x"])) == {"x"}
    with pytest.raises(al.ProblemError, match=r"2e\+07 numbers at 20 points would need"):
        al.expand(lambda at: at["a"] * jnp.ones(10**6), {"a": al.Normal(0.0, 1.0)}, al.Expansion(3, points=12))


def test_the_limit_of_a_container_counts(tmp_path, monkeypatch):
    def found(own, **limits):
        (tmp_path / "own").write_text(own)
        for place, limit in limits.items():
            file = tmp_path / place.replace("__", "/") / "memory.max"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(limit)
        return arrays.memory.__wrapped__()

    monkeypatch.setattr(arrays, "_GROUPS", tmp_path)
    monkeypatch.setattr(arrays, "_OWN_GROUP", tmp_path / "own")
    whole = found("0::/\n")
    assert whole > 2**28
    assert found("0::/a/b\n", a="100000\n", a__b="max\n") == 100_000
    assert found("0::/a/b\n", a__b="50000\n") == 50_000
    assert found("1:name=old:/\n") == whole
