import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mujoco_trees import Tree

import aleator as al
from aleator.joints import Ball, Free, Prismatic, Revolute
from aleator.uncertainty import placements, realise
from compiling import answers, compiled, programs_listed


def test_an_uncertain_body_may_be_a_field_itself():
    model = Tree((al.Body("slider", joint=Prismatic("x"), mass=al.Uniform(2.0, half_width=0.5)),))
    assert model.coordinates == ("slider",)
    assert model.speeds == ("slider_rate",)
    assert len(placements(model).germ_names) == 1
    (mass,) = answers(model, [lambda model: realise(model, jnp.array([0.5]), jnp.zeros(0)).mass_matrix(jnp.zeros(1))])
    np.testing.assert_allclose(mass, [[2.25]], rtol=1e-14)


def test_bodies_are_asked_for_the_structure_of_a_model_once_and_again_for_another_model():
    asked = []

    class Counted(Tree):
        def bodies(self):
            asked.append(len(self.given))
            return super().bodies()

    one = Counted((al.Body("slider", joint=Prismatic("x"), mass=1.0),))
    other = Counted((al.Body("ball", joint=Ball(), mass=1.0), al.Body("tip", parent="ball", joint=Ball(), mass=1.0)))
    assert [len(model.speeds) for model in (one, other, one, other)] == [1, 6, 1, 6]
    assert len(one.coordinates) == 1
    assert asked == [1, 2]


FLOATING = Tree((al.Body("base", joint=Free(), mass=1.0), al.Body("head", parent="base", joint=Ball(), mass=1.0)))


def test_quaternions_are_brought_to_length_one_and_zero_is_no_turn():
    @compiled
    def normalised(q):
        return FLOATING.normalised(q), jax.jacfwd(FLOATING.normalised)(q)

    q = np.array([1.0, -2.0, 3.0, 0.0, 3.0, 0.0, -4.0, 0.1, 0.0, 0.0, 0.0])
    expected = [1.0, -2.0, 3.0, 0.0, 0.6, 0.0, -0.8, 1.0, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(normalised(q)[0], expected, rtol=1e-15)
    unturned, slope = (np.asarray(one) for one in normalised(np.zeros(11)))
    np.testing.assert_array_equal(np.flatnonzero(unturned), [3, 7])
    assert np.isfinite(slope).all()


def test_a_joint_that_moves_no_inertia_gives_no_acceleration_rather_than_a_wrong_one():
    tip = al.Body("tip", parent="upper", joint=Revolute("z"), mass=0.0)
    tree = Tree((al.Body("upper", joint=Revolute("z"), mass=1.0, center=(1, 0, 0)), tip))
    assert not np.isfinite(compiled(tree.forward_dynamics)(*np.ones((3, 2)))).any()


def body(name="one", **changes):
    return al.Body(name, **({"joint": Revolute("z"), "mass": 1.0} | changes))


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        (lambda: (body("a", parent="b"), body("b", parent="a")), "cycle"),
        (lambda: (body(inertia=(1, 1, 3)),), "beyond the sum of the other two"),
        (lambda: (body(inertia=[[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]),), "expected a symmetric matrix"),
        (lambda: (body(orientation=2 * np.eye(3)),), "expected a rotation matrix"),
    ],
)
def test_bodies_that_make_no_tree_are_refused_in_words(bodies, message):
    with pytest.raises(al.ProblemError, match=message):
        Tree(bodies()).bias(jnp.zeros(1), jnp.zeros(1))


class Raised(al.Lagrangian):
    """A mass on a spring."""

    mass: al.Number = 1.0
    names = ("height",)

    def kinetic_energy(self, q, v):
        return 0.5 * self.mass * v @ v

    def potential_energy(self, q):
        return self.mass * 9.81 * q[0] + 5.0 * q @ q


def test_trees_on_simple_joints_are_diagnosed_without_a_program_and_other_models_by_one():
    grid, level = al.Grid(1.0, 8), al.PowerSeries(start=(0.0, 0.0, 0.0), end=(1.0, 0.0, 0.0))
    arm = al.Body("arm", joint=Revolute("y"), mass=2.0, center=(0.5, 0.0, 0.0), inertia=(0.1, 0.2, 0.2))
    slide = al.Body("slide", parent="arm", joint=Prismatic("x", damping=1.0), mass=1.0, position=(1.0, 0.0, 0.0))
    tree = al.InverseDynamics(Tree((arm, slide)), motion={"arm": level, "slide": level})
    with programs_listed() as programs:
        assert tree.diagnose(grid) == ""
    assert programs == []
    with programs_listed() as programs:
        for mass in (1.0, 2.0):
            raised = al.InverseDynamics(Raised(mass), motion={"height": level})
            assert raised.diagnose(grid) == ""
    assert len(programs) == 1
