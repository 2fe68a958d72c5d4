"""Bricard's mechanism: five rods of 1 m in a loop with one equation too many, and yet one freedom.

IFToMM benchmark A04. `POSITIONS` of the third hinge are independent: the path by Newton's method, the effective
inertia of the single freedom, and DOP853 to 1e-11.
"""

import numpy as np
import pytest

import aleator as al

POSITIONS = {
    0.5: (0.7747178, -0.9798150, -0.1999062),
    1.0: (0.2744813, -0.8867079, -0.4623300),
    1.5: (-0.2790176, -0.8873614, -0.4610746),
    2.0: (-0.7781354, -0.9803527, -0.1972527),
}
# The ends of the rods, and the axis of the hinge at the first end of each; the last hinge is on the ground.
POINTS = np.array([(0, 0, 0), (1, 0, 0), (1, -1, 0), (1, -1, 1), (0, -1, 1), (0, 0, 1)], dtype=float)
AXES = ((0.0, -1.0, 0.0), "z", "x", (0.0, -1.0, 0.0), "z", "x")
RODS = tuple(f"rod_{i}" for i in range(1, 6))


class Bricard(al.Multibody):
    gravity = (0.0, -9.81, 0.0)
    actuators = ()

    def bodies(self):
        along = np.diff(POINTS, axis=0)
        return tuple(
            al.Body(
                name,
                parent=RODS[i - 1] if i else None,
                joint=al.joints.Revolute(AXES[i]),
                position=along[i - 1] if i else POINTS[0],
                mass=1.0,
                center=along[i] / 2,
                inertia=np.where(along[i] != 0, 0.02 / 12, 1.01 / 12),
            )
            for i, name in enumerate(RODS)
        )

    def last_hinge(self, joint):
        return al.joints.Closure(
            "last", parent="rod_5", child=None, joint=joint, position=POINTS[5] - POINTS[4], child_position=POINTS[5]
        )

    def outputs(self, motion):
        x, y, z = self.point(motion.q, "rod_2", POINTS[2] - POINTS[1])
        energy = self.kinetic_energy(motion.q, motion.v) + self.potential_energy(motion.q)
        return {"x": x, "y": y, "z": z, "energy": energy}


class Overconstrained(Bricard):
    def closures(self):
        return (self.last_hinge(al.joints.Revolute("x")),)


class Independent(Bricard):
    """The point and one of the two angles: the other follows."""

    constraint_names = ("last_turn",)

    def closures(self):
        return (self.last_hinge(al.joints.Ball()),)

    def constraint(self, q):
        return (self.poses(q)["rod_5"].rotation[1, 0],)


@pytest.mark.slow
def test_five_equations_of_rank_four_are_refused():
    with pytest.raises(al.ProblemError, match="expected 5 that are independent; their rank is 4, for 'last_x'"):
        al.simulate(al.ForwardDynamics(Overconstrained()), al.Grid(2.0, 10))


@pytest.mark.slow
def test_four_independent_equations_move_it():
    found = al.simulate(al.ForwardDynamics(Independent()), al.Grid(2.0, 1000))
    for time, position in POSITIONS.items():
        assert [found[name][round(500 * time)] for name in "xyz"] == pytest.approx(position, abs=1e-5)
    assert found["energy"] == pytest.approx(-29.43, abs=1e-5)
