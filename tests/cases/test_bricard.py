"""Bricard's mechanism: five rods of 1 m in a loop with one equation too many, and yet one freedom.

IFToMM benchmark A04.
"""

import numpy as np
import pytest

import aleator as al

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

    def closures(self):
        hinge, place = al.joints.Revolute("x"), POINTS[5] - POINTS[4]
        last = {"parent": "rod_5", "child": None, "position": place, "child_position": POINTS[5]}
        return (al.joints.Closure("last", joint=hinge, **last),)


@pytest.mark.slow
def test_five_equations_of_rank_four_are_refused():
    with pytest.raises(al.ProblemError, match="expected 5 that are independent; their rank is 4, for 'last_x'"):
        al.simulate(al.ForwardDynamics(Bricard()), al.Grid(2.0, 10))
