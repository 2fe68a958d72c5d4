"""HIRES: eight substances of a plant under high irradiance, on scales from 1e-5 to 1, stiff.

Schäfer (1975); Test Set for IVP Solvers, problem "hires", whose published end is `END`.
"""

import numpy as np
import pytest

import aleator as al

END = (0.7371312573325668e-3, 0.1442485726316185e-3, 0.5888729740967575e-4, 0.1175651343283149e-2)
END = (*END, 0.2386356198831331e-2, 0.6238968252742796e-2, 0.2849998395185769e-2, 0.2850001604814231e-2)

# For a source of U(0.00063, 0.00077) at t = 100: Gauss-Legendre quadrature of 6 points over tight runs.
MEANS = (4.52085956e-3, 8.83905671e-4, 7.97194326e-4, 7.81132640e-3, 0.132385261, 0.530167725, 5.63133747e-3)
MEANS = (*MEANS, 6.86625256e-5)
SPREADS = (5.93153580e-5, 1.15868678e-5, 6.76182636e-6, 9.60445358e-5, 7.59032353e-4, 3.09799320e-3)
SPREADS = (*SPREADS, 3.96355083e-7, 3.96355083e-7)


class Hires(al.System):
    states = tuple(f"y{i}" for i in range(1, 9))

    source: al.Number = 0.0007
    k7: al.Number = 280.0

    def initial(self):
        return {"y1": 1.0, "y8": 0.0057}

    def rhs(self, t, z):
        y1, y2, y3, y4, y5, y6, y7, y8 = z
        k1, k2, k3, k4, k5, k6, k8, k9 = 1.71, 0.43, 8.32, 0.69, 0.035, 8.32, 0.69, 0.69
        bound = self.k7 * y6 * y8 - (k2 + k8 + k9) * y7
        return (
            -k1 * y1 + k2 * y2 + k6 * y3 + self.source,
            k1 * y1 - (k2 + k3) * y2,
            -(k6 + k1) * y3 + k2 * y4 + k5 * y5,
            k3 * y2 + k1 * y3 - (k4 + k2) * y4,
            -(k5 + k1) * y5 + k2 * (y6 + y7),
            -self.k7 * y6 * y8 + k8 * y4 + k1 * y5 - k2 * y6 + k8 * y7,
            bound,
            -bound,
        )

    def outputs(self, t, z):
        return z._asdict()


@pytest.mark.slow
def test_all_substances_end_as_published():
    found = al.simulate(Hires(), al.Grid(321.8122, 400), integrator=al.integrators.Rodas5P())
    assert [found[name][-1] for name in Hires.states] == pytest.approx(END, rel=1e-6)


@pytest.mark.slow
def test_an_uncertain_source_spreads_all_substances():
    def end(model):
        tight = al.integrators.Rodas5P(rtol=1e-10, atol=1e-13)
        found = al.simulate(model, al.Grid(100.0, 200), integrator=tight)
        return {name: found[name][-1] for name in Hires.states}

    found = al.expand(end, Hires(source=al.Uniform.bounds(0.00063, 0.00077)), al.Expansion(order=4))
    assert np.array([found[name].mean for name in Hires.states]) == pytest.approx(MEANS, rel=1e-6)
    assert np.array([found[name].std for name in Hires.states]) == pytest.approx(SPREADS, rel=1e-4)


@pytest.mark.slow
def test_a_substance_about_to_fall_is_spread_by_half_of_its_mean():
    def end(model):
        return al.simulate(model, al.Grid(321.8122, 100), integrator=al.integrators.Rodas5P())["y6"][-1]

    model = Hires(source=al.Uniform.bounds(0.00063, 0.00077), k7=al.Uniform.bounds(252.0, 308.0))
    found = al.expand(end, model, al.Expansion(order=3))
    # Gauss-Legendre quadrature of 10 by 10 points over SciPy's LSODA.
    assert found.mean == pytest.approx(0.00709780526, rel=1e-3)
    assert found.std == pytest.approx(0.00364743977, rel=1e-3)


@pytest.mark.slow
def test_collocation_finds_the_source_that_leads_to_the_published_end():
    grid, stiff = al.Grid(321.8122, 100), al.integrators.Rodas5P()
    # Explicit steps of a simulated start would be unstable.
    near = {"time": grid.times, **al.simulate(Hires(source=0.00071), grid, integrator=stiff)}
    problem = al.Problem(
        Hires(source=al.Decision(0.00071, 0.0006, 0.0008)),
        grid=grid,
        integrator=stiff,
        minimize=al.value("source"),
        subject_to=[al.terminal("y1").mean.equals(END[0])],
    )
    solution = al.solve(problem, transcription=al.Simultaneous(al.schemes.Radau(3), error=1e-8, guess=near))
    assert solution.decisions["source"] == pytest.approx(0.0007, rel=1e-6)
    assert solution.mesh_states is not None
    assert [solution.mesh_states[name][0, -1] for name in Hires.states] == pytest.approx(END, rel=1e-6)
