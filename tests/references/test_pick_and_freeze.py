import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al

ISHIGAMI = {name: al.Uniform(0.0, half_width=np.pi) for name in ("x", "y", "z")}


def ishigami(m):
    return jnp.sin(m["x"]) + 7 * jnp.sin(m["y"]) ** 2 + 0.1 * m["z"] ** 4 * jnp.sin(m["x"])


def misses(found, exact):
    return {name: abs(found[name].value - exact[name]) / found[name].standard_error for name in exact}


def test_indices_of_the_ishigami_function_are_the_published_ones():
    found = al.references.sobol_indices(ishigami, ISHIGAMI, seed=2)
    # Ishigami and Homma (1990), for a = 7 and b = 0.1; Student's distribution with 15 degrees of freedom leaves 4.1 in
    # 1000.
    assert max(misses(found.first, {"x": 0.313905, "y": 0.442411, "z": 0.0}).values()) < 4.1
    assert max(misses(found.total, {"x": 0.557589, "y": 0.442411, "z": 0.243684}).values()) < 4.1
    assert all(one.standard_error < 0.005 for one in [*found.first.values(), *found.total.values()])


def test_standard_errors_are_as_large_as_the_true_errors():
    scaled = []
    for seed in range(20):
        found = al.references.sobol_indices(ishigami, ISHIGAMI, 16 * 64, seed=seed)
        scaled.append((found.total["x"].value - 0.557589) / found.total["x"].standard_error)
    assert np.std(scaled) == pytest.approx(1.07, rel=0.4)


def test_indices_have_the_structure_of_the_outputs():
    def outputs(m):
        return {"path": m["x"] * jnp.arange(3.0) + 5.0, "y": m["y"]}

    found = al.references.sobol_indices(outputs, ISHIGAMI, 16 * 64)
    # The first instant is certain, and nothing has a share of it.
    np.testing.assert_allclose(found.total["x"]["path"].value, [0, 1, 1], atol=0.05)
    np.testing.assert_allclose(found.first["y"]["path"].value, 0, atol=0.05)
    assert found.total["y"]["y"].value == pytest.approx(1.0, abs=0.05)
    assert "x: first" in str(al.references.sobol_indices(ishigami, ISHIGAMI, 16 * 64))


def test_a_constant_output_is_refused():
    with pytest.raises(al.ProblemError, match="does not vary"):
        al.references.sobol_indices(lambda m: 0 * m["x"] + 2, ISHIGAMI, 16 * 64)
