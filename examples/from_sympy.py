"""A crane modelled in SymPy, driven so that its load hangs still at the end, whatever the length of the rope is.

The equations of motion come from SymPy's `LagrangesMethod`. The trolley follows a B-spline, the load swings freely. The
rope is only known to 15 cm and the load to a tenth; the motion minimises what is left of the swing, on the average and
in its spread, without exceeding the force of the drive.

    python examples/from_sympy.py
"""

import numpy as np
import sympy as sp
from sympy.physics import mechanics as me

import aleator as al

# In the plane of x and y: a trolley of mass M, and a load of mass m on a rope of length l, with friction in the air.
M, m, rope, g, drag = sp.symbols("M m l g drag")
x, swing, force = me.dynamicsymbols("x swing force")
world, above = me.ReferenceFrame("world"), me.Point("above")
above.set_vel(world, 0)
trolley = above.locatenew("trolley", x * world.x)
trolley.set_vel(world, x.diff() * world.x)
hook = trolley.locatenew("hook", rope * (sp.sin(swing) * world.x - sp.cos(swing) * world.y))
hook.set_vel(world, hook.pos_from(above).dt(world))
load = me.Particle("load", hook, m)
load.potential_energy = -m * g * rope * sp.cos(swing)
crane = me.LagrangesMethod(
    me.Lagrangian(world, me.Particle("trolley", trolley, M), load),
    [x, swing],
    forcelist=[(trolley, force * world.x), (hook, -drag * hook.vel(world))],
    frame=world,
)
crane.form_lagranges_equations()

model = al.foreign.from_lagrange(
    crane,
    {M: 20.0, m: al.Uniform(10.0, half_width=1.0), rope: al.Uniform(1.5, half_width=0.15), g: 9.81, drag: 0.5},
    outputs={"energy": m * rope * (rope * swing.diff() ** 2 / 2 + g * (1 - sp.cos(swing)))},
    units={"energy": "J", "force": "N"},
)
ends = {"start": (0.0, 0.0, 0.0), "end": (2.0, 0.0, 0.0)}
path = al.BSpline(al.Decision(al.fit_control_points(np.linspace(0.0, 2.0, 40), 6, **ends), -1.0, 3.0), **ends)
problem = al.Problem(
    al.HybridDynamics(model, motion={"x": path}),
    grid=al.Grid(3.0, steps=150),
    minimize=al.terminal("energy").mean + al.terminal("energy").std,
    subject_to=[al.path("force").within(-80.0, 80.0, sigmas=2.0)],
    expansion=al.Expansion(order=4),
)

if __name__ == "__main__":
    solution = al.solve(problem)
    print(problem)
    print(solution)
    print(al.validate(solution, samples=2000))
