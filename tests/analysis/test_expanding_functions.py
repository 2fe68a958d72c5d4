"""`al.expand` against closed forms, quadrature, chaospy and finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import aleator as al
from aleator.expansion import GaussPoints, Projection, SmolyakPoints
from compiling import compiled

DECAY = {"b": al.Uniform.bounds(0.1, 0.2), "u": al.Normal(1.5, 0.2)}
DECAY_MEAN, DECAY_VARIANCE = 0.348816236902, 0.012314725652


def decay(model):
    return model["u"] * jnp.exp(-10.0 * model["b"])


def test_the_uncertain_decay_has_its_published_moments():
    expanded = al.expand(decay, DECAY, al.Expansion(order=10))
    assert float(expanded.mean) == pytest.approx(DECAY_MEAN, abs=1e-8)
    assert float(expanded.variance) == pytest.approx(DECAY_VARIANCE, abs=1e-8)


def test_the_outputs_keep_their_structure_in_every_statistic():
    times = np.linspace(0.0, 2.0, 5)
    expanded = al.expand(lambda m: {"x": m["u"] * times, "y": (m["b"], 2 * m["u"])}, DECAY)
    assert expanded.mean["x"] == pytest.approx(1.5 * times, abs=1e-12)
    assert [float(one) for one in expanded.std["y"]] == pytest.approx([0.1 / np.sqrt(12), 0.4], rel=1e-10)
    assert expanded["x"].std == pytest.approx(np.asarray(expanded.std["x"]), abs=0)
    assert float(expanded["x"].leave_one_out) < 1e-10
    with pytest.raises(al.ProblemError, match=r"no output 'z'.*'x', 'y'"):
        expanded["z"]
    with pytest.raises(al.ProblemError, match="without a name"):
        expanded["x"]["z"]


def test_the_surrogate_takes_inputs_germ_points_and_samples():
    expanded = al.expand(decay, DECAY, al.Expansion(order=10))
    assert float(expanded({"u": 1.4, "b": 0.17})) == pytest.approx(1.4 * np.exp(-1.7), rel=1e-10)
    assert float(expanded.at_germ([[0.4, -0.5]])[0]) == pytest.approx(1.4 * np.exp(-1.7), rel=1e-10)
    values = np.asarray(expanded.sample(20_000, seed=1))
    assert values.shape == (20_000,)
    assert values.mean() == pytest.approx(DECAY_MEAN, abs=4 * np.sqrt(DECAY_VARIANCE / 20_000))
    for wrong, message in [({"u": 1.4}, "each of"), ({"u": 1.0, "b": 0.3}, "outside its distribution")]:
        with pytest.raises(al.ProblemError, match=message):
            expanded(wrong)
    with pytest.raises(al.ProblemError, match=r"shape \(n, 2\)"):
        expanded.at_germ([0.0, 0.0])
    square = al.expand(lambda m: m["x"] ** 2, {"x": al.Normal(0.0, 1.0)}, al.Expansion(2))
    assert [float(square({"x": far})) for far in (20.0, -20.0)] == pytest.approx([400.0, 400.0], rel=1e-12)
    for wrong in (np.inf, np.nan, [1.0], None):
        with pytest.raises(al.ProblemError, match="x: expected a finite number"):
            square({"x": wrong})


def test_moments_of_few_data_are_theirs_at_every_order_that_they_carry():
    data = np.array([0.0, 1.0, 1.0, 3.0, 7.0])
    expanded = al.expand(lambda m: m["x"] ** 2, {"x": al.Sample(data)}, al.Expansion(3, points=al.points.GaussPoints()))
    assert float(expanded.skewness) == pytest.approx(stats.skew(data**2), rel=1e-12)
    assert float(expanded.kurtosis) == pytest.approx(stats.kurtosis(data**2, fisher=False), rel=1e-12)


def test_data_are_sampled_at_their_own_values_and_no_element_divides_them():
    data = {"x": al.Sample([1.0, 2.0, 3.0])}
    expanded = al.expand(lambda m: 1 / m["x"], data, al.Expansion(2, points=al.points.OptimalPoints()))
    inverse = np.array([1, 1 / 2, 1 / 3])
    assert [float(expanded.mean), float(expanded.std)] == pytest.approx([inverse.mean(), inverse.std()], rel=1e-12)
    with pytest.raises(al.ProblemError, match=r"MultiElement divides densities; .*Sample for 'x'.*order=2"):
        al.expand(lambda m: 1 / m["x"], data, al.MultiElement(order=1))


def call_by_call(model):
    if model["b"] > 0.15:
        return {"y": np.array([model["u"], np.sin(model["b"])])}
    return {"y": np.array([model["u"], float(np.sin(model["b"]))])}


def test_a_function_that_jax_cannot_trace_is_called_point_by_point_on_request():
    with pytest.raises(al.ProblemError, match=r"'call_by_call' cannot be traced by JAX.*traced=False"):
        al.expand(call_by_call, DECAY)
    expanded = al.expand(call_by_call, DECAY, al.Expansion(6), traced=False)
    traced = al.expand(lambda m: {"y": jnp.stack([m["u"], jnp.sin(m["b"])])}, DECAY, al.Expansion(6))
    assert np.asarray(expanded.mean["y"]) == pytest.approx(np.asarray(traced.mean["y"]), rel=1e-13)
    assert np.asarray(expanded.std["y"]) == pytest.approx(np.asarray(traced.std["y"]), rel=1e-13)
    with pytest.raises(al.ProblemError, match="nothing can be differentiated"):
        jax.grad(lambda s: al.expand(call_by_call, {"u": al.Normal(1.5, s), "b": 0.1}, traced=False).std["y"][0])(0.2)


@pytest.mark.parametrize(("traced", "bad"), [(True, "10 of 20"), (False, "7 of 14")])
def test_an_output_that_is_not_finite_names_the_point_and_the_inputs(traced, bad):
    library = jnp if traced else np
    told = rf"not finite at {bad} .*'z'.* \(b=0\.1"
    with np.errstate(all="ignore"), pytest.raises(al.SimulationError, match=told):
        al.expand(lambda m: {"z": library.sqrt(m["b"] - 0.15)}, {"b": DECAY["b"]}, traced=traced)


def test_what_is_certain_or_draws_its_own_random_numbers_is_refused():
    with pytest.raises(al.ProblemError, match="nothing in the model is uncertain"):
        al.expand(decay, {"b": 0.1, "u": 2.0})

    def response(m):
        return m["u"] + np.random.default_rng().normal()

    with pytest.raises(al.ProblemError, match="'response' computes something else each time"):
        al.expand(response, DECAY)


def test_an_expansion_that_does_not_converge_warns_and_names_the_remedy():
    with pytest.warns(al.ExpansionWarning, match=r"order 3 does not resolve jump .*Raise the order.*MultiElement"):
        al.expand(lambda m: {"jump": jnp.where(m["b"] > 0.12, 1.0, 0.0), "u": m["u"]}, DECAY)


def test_arrays_held_by_compiled_helpers_tell_functions_apart():
    def times(gain):
        held = jnp.asarray(gain)
        helper = jax.jit(lambda x: held * x)
        return lambda m: helper(m["u"])

    means = [float(al.expand(times(gain), DECAY).mean) for gain in (2.0, 3.0)]
    assert means == pytest.approx([3.0, 4.5])


def test_the_derivative_of_the_standard_deviation_is_that_of_the_closed_form():
    def std(h):
        return al.expand(lambda m: jnp.exp(m["w"]), {"w": al.Uniform(1.0, half_width=h)}, al.Expansion(10)).std

    def exact(h):
        first = jnp.e * jnp.sinh(h) / h
        return jnp.sqrt(jnp.e**2 * jnp.sinh(2 * h) / (2 * h) - first**2)

    both = compiled(lambda h: (jax.value_and_grad(std)(h), jax.value_and_grad(exact)(h)))
    (value, slope), (expected, by) = both(0.4)
    assert float(value) == pytest.approx(float(expected), rel=1e-11)
    assert float(slope) == pytest.approx(float(by), rel=1e-9)


def test_a_sparse_grid_that_leaves_nothing_to_check_is_judged_by_its_highest_degrees():
    sparse = al.Expansion(6, points=SmolyakPoints(), fit=Projection())
    fine = al.expand(decay, DECAY, sparse)
    assert float(fine.leave_one_out) == np.inf
    assert float(fine.error) < 1e-3
    assert float(fine.variance) == pytest.approx(DECAY_VARIANCE, abs=1e-8)
    with pytest.warns(al.ExpansionWarning, match="does not resolve"):
        al.expand(lambda m: jnp.cos(200 * m["b"]) * m["u"], DECAY, sparse)


def test_a_gauss_grid_that_interpolates_along_its_axes_does_not_pass_for_resolved():
    distributions = {name: al.Uniform.bounds(-1.0, 1.0) for name in ("x", "y")}
    grid = al.Expansion(order=5, points=GaussPoints(), fit=Projection())
    with pytest.warns(al.ExpansionWarning, match="does not resolve"):
        expanded = al.expand(lambda at: jnp.cos(10 * at["x"]) + at["y"], distributions, grid)
    assert float(expanded.error) > 0.05
    assert float(expanded.leave_one_out) == np.inf  # no collocation point checks it, fresh ones do


def test_a_gauss_grid_that_holds_the_output_exactly_is_resolved():
    distributions = {name: al.Uniform.bounds(-1.0, 1.0) for name in ("x", "y")}
    expanded = al.expand(lambda at: at["x"] + at["y"], distributions, al.Expansion(order=1, points=GaussPoints()))
    assert float(expanded.error) < 1e-12
    assert "(resolved)" in str(expanded)


INPUT = {"x": al.Uniform.bounds(0.0, 2.0)}


def expanded(function, model):
    return float(al.expand(function, model, al.Expansion(order=3)).mean)


def test_whole_numbers_of_the_model_are_part_of_the_equations():
    for power in (1, 3, 1):
        assert expanded(lambda m: m["x"] * 2.0 ** m["power"], {**INPUT, "power": power}) == pytest.approx(2.0**power)
