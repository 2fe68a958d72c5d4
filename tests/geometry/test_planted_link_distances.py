"""Distances of links that are grouped by their kinds: each is that of its own pair, by closed forms."""

import numpy as np

from aleator.geometry import Capsule, Sphere, link_distances
from compiling import compiled


def test_distances_of_links_of_two_kinds_come_in_the_order_of_their_pairs():
    # A rod along the x axis among points: grouped by kinds, the pairs 1-2, 1-3 and 2-3 change places in a cycle.
    points = {0: np.array([-3.0, 4.0]), 2: np.array([2.0, 1.0]), 3: np.array([5.0, 2.0])}
    rod = Capsule([0.0, 0.0], [4.0, 0.0], 0.5)
    links = [Sphere(points[0]), rod, Sphere(points[2]), Sphere(points[3])]

    def away(i: int, j: int) -> float:
        if 1 not in (i, j):
            return float(np.linalg.norm(points[i] - points[j]))
        (place,) = (points[k] for k in (i, j) if k != 1)
        return float(np.linalg.norm(place - [np.clip(place[0], 0.0, 4.0), 0.0])) - 0.5

    expected = [away(i, j) for i in range(4) for j in range(i + 1, 4)]
    np.testing.assert_allclose(compiled(lambda: link_distances(links, apart=1))(), expected, rtol=1e-12)
