"""The drawings of the studies: each whole and labelled, and that of the clutch to the scale of its dimensions."""

import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from aleator.studies.clutch import MEANS
from aleator.studies.clutch._drawing import clutch_drawing
from aleator.studies.four_bar._drawing import linkage_drawing
from aleator.studies.suspension import nominal, road
from aleator.studies.suspension._drawing import car_drawing
from aleator.studies.swing_up import DoublePendulum
from aleator.studies.swing_up._drawing import pendulum_drawing
from aleator.studies.two_link_arm import OBSTACLE, TwoLinkArm
from aleator.studies.two_link_arm._views import arm_drawing

SVG = "{http://www.w3.org/2000/svg}"


def arm():
    return arm_drawing(TwoLinkArm(payload=1.0, obstacle=OBSTACLE))


def car():
    return car_drawing(nominal(), np.asarray(road().times), np.asarray(road().values))


DRAWINGS = {
    "clutch": (clutch_drawing, ["a", "b", "c", "e", "γ", "hub", "roller", "ring"]),
    "arm": (arm, ["q₁, τ₁", "q₂, τ₂", "wall", "obstacle", "target", "start, M(ξ)"]),
    "pendulum": (lambda: pendulum_drawing(DoublePendulum()), ["q₁, τ₁", "q₂ (free)", "m₂(ξ)", "g", "start", "target"]),
    "car": (car, ["zₛ", "zᵤ", "road", "mᵤ = 94 kg", "mₛ(ξ) = 376 ± 47 kg", "kₛ(ξ) = kₛ⁰ ± 3750 N/m"]),
    "linkage": (linkage_drawing, ["θ, τ", "crank", "coupler", "rocker", "tool"]),
}


def part(svg, kind):
    (found,) = [one for one in ElementTree.fromstring(svg).iter() if one.get("class") == kind]
    return found


def points(element):
    return np.array([[float(x), float(y)] for x, y in re.findall(r"(-?[\d.]+) (-?[\d.]+)", element.get("d"))])


def disc(svg, kind):
    return tuple(float(part(svg, kind).get(name)) for name in ("cx", "cy", "r"))


def words_of(svg):
    return [one.text for one in ElementTree.fromstring(svg).iter(f"{SVG}text")]


@pytest.mark.parametrize("name", DRAWINGS)
def test_a_drawing_is_well_formed_names_its_parts_and_stays_inside_its_frame(name):
    drawing, symbols = DRAWINGS[name]
    tree = ElementTree.fromstring(drawing())
    assert set(symbols) <= set(words_of(drawing()))
    assert not re.search("#[0-9a-f]{3}", drawing())  # in the colour of the page
    _, _, width, height = map(float, tree.get("viewBox").split())
    for one in tree.iter(f"{SVG}path"):
        assert np.all((points(one) >= 0) & (points(one) <= [width, height]))
    for one in tree.iter(f"{SVG}text"):
        reach = 0.55 * float(one.get("font-size")) * len(one.text)  # about the width of a word
        left = float(one.get("x")) - reach * {"start": 0.0, "middle": 0.5, "end": 1.0}[one.get("text-anchor")]
        assert 0 <= left <= left + reach <= width
        assert 8 <= float(one.get("y")) <= height


@pytest.mark.parametrize("dimensions", [MEANS, {"a": 25.0, "c": 12.0, "e": 51.0}], ids=["study", "other"])
def test_the_roller_touches_hub_and_ring_where_the_closed_form_says(dimensions):
    svg = clutch_drawing(dimensions)
    a, c, e = dimensions.values()
    ring = points(part(svg, "ring"))
    origin = np.array([ring[-1][0], ring[0][1]])
    scale = (ring[0][0] - origin[0]) / e
    x, y, radius = disc(svg, "roller")
    top = points(part(svg, "hub"))[1][1]
    # It touches the hub from above, and the ring from within.
    drawn = [radius, origin[1] - top, top - y, math.dist((x, y), origin)]
    assert np.array(drawn) / scale == pytest.approx([c, a, c, e - c], abs=0.01)
    chi = math.degrees(math.acos((a + c) / (e - c)))
    assert f"χ = {chi:.3f}°" in words_of(svg)
    assert math.degrees(math.atan2(x - origin[0], origin[1] - y)) == pytest.approx(chi, abs=0.02)
