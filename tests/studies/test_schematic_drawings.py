"""The drawings of the studies agree with the numbers of their models: read back from the SVG, in the model's units."""

import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from aleator.reporting import Page, Schematic, Section, Verdict, page_html, sketch
from aleator.studies.clutch import MEANS
from aleator.studies.clutch._drawing import clutch_drawing
from aleator.studies.four_bar import LENGTHS
from aleator.studies.four_bar._drawing import linkage_drawing
from aleator.studies.suspension import QuarterCar, apportioned, nominal, road
from aleator.studies.suspension._drawing import car_drawing
from aleator.studies.swing_up import DoublePendulum
from aleator.studies.swing_up._drawing import pendulum_drawing
from aleator.studies.two_link_arm import OBSTACLE, TwoLinkArm
from aleator.studies.two_link_arm._drawing import arm_drawing

SVG = "{http://www.w3.org/2000/svg}"


def arm(**numbers):
    return arm_drawing(TwoLinkArm(payload=1.0, obstacle=OBSTACLE, **numbers))


def car(model=None):
    profile = road()
    return car_drawing(nominal() if model is None else model, np.asarray(profile.times), np.asarray(profile.values))


DRAWINGS = {
    "clutch": clutch_drawing,
    "arm": arm,
    "pendulum": lambda: pendulum_drawing(DoublePendulum()),
    "car": car,
    "linkage": linkage_drawing,
}


def part(svg, kind):
    (found,) = [one for one in ElementTree.fromstring(svg).iter() if one.get("class") == kind]
    return found


def points(element):
    return np.array([[float(x), float(y)] for x, y in re.findall(r"(-?[\d.]+) (-?[\d.]+)", element.get("d"))])


def lengths(svg, kind):
    return np.linalg.norm(np.diff(points(part(svg, kind)), axis=0), axis=1)


def round_part(svg, kind):
    found = part(svg, kind)
    return tuple(float(found.get(name)) for name in ("cx", "cy", "r"))


def words_of(svg):
    return [one.text for one in ElementTree.fromstring(svg).iter(f"{SVG}text")]


SYMBOLS = {
    "clutch": ["a", "b", "c", "e", "γ", "hub", "roller", "ring"],
    "arm": ["q₁, τ₁", "q₂, τ₂", "wall", "obstacle", "target", "start, M(ξ)"],
    "pendulum": ["q₁, τ₁", "q₂ (free)", "m₂(ξ)", "g", "start", "target"],
    "linkage": ["θ, τ", "crank", "coupler", "rocker", "tool"],
    "car": ["zₛ", "zᵤ", "road", "mᵤ = 94 kg", "mₛ(ξ) = 376 ± 47 kg", "kₛ(ξ) = kₛ⁰ ± 3750 N/m"],
}


@pytest.mark.parametrize("name", DRAWINGS)
def test_a_drawing_is_well_formed_names_its_parts_and_stays_inside_its_frame(name):
    svg = DRAWINGS[name]()
    tree = ElementTree.fromstring(svg)
    assert set(SYMBOLS[name]) <= set(words_of(svg))
    assert not re.search("#[0-9a-f]{3}", svg)  # in the colour of the page
    _, _, width, height = map(float, tree.get("viewBox").split())
    for one in tree.iter(f"{SVG}path"):
        assert np.all((points(one) >= 0) & (points(one) <= [width, height]))
    for one in tree.iter(f"{SVG}text"):
        reach = 0.55 * float(one.get("font-size")) * len(one.text)  # about the width of a word
        x, y = float(one.get("x")), float(one.get("y"))
        left = x - reach * {"start": 0.0, "middle": 0.5, "end": 1.0}[one.get("text-anchor")]
        assert left >= 0
        assert left + reach <= width
        assert 8 <= y <= height


@pytest.mark.parametrize("dimensions", [MEANS, {"a": 25.0, "c": 12.0, "e": 51.0}])
def test_the_roller_touches_hub_and_ring_where_the_closed_form_says(dimensions):
    svg = clutch_drawing(dimensions)
    a, c, e = dimensions.values()
    ring = points(part(svg, "ring"))
    origin = np.array([ring[-1][0], ring[0][1]])
    scale = (ring[0][0] - origin[0]) / e
    x, y, radius = round_part(svg, "roller")
    assert radius / scale == pytest.approx(c, abs=0.01)
    top = points(part(svg, "hub"))[1][1]
    assert (origin[1] - top) / scale == pytest.approx(a, abs=0.01)
    assert (top - y) / scale == pytest.approx(c, abs=0.01)  # touches the hub
    assert math.dist((x, y), origin) / scale == pytest.approx(e - c, abs=0.01)  # touches the ring from within
    chi = math.degrees(math.acos((a + c) / (e - c)))
    assert f"χ = {chi:.3f}°" in words_of(svg)
    assert math.degrees(math.atan2(x - origin[0], origin[1] - y)) == pytest.approx(chi, abs=0.02)


@pytest.mark.parametrize("lengths", [LENGTHS, LENGTHS | {"crank": 80.0, "rocker": 250.0}])
def test_the_bars_of_the_linkage_are_drawn_to_one_scale(lengths):
    svg = linkage_drawing(lengths)
    crank, rocker, coupler = (points(part(svg, kind)) for kind in ("crank", "rocker", "coupler"))
    scale = math.dist(*crank) / lengths["crank"]
    assert math.dist(*rocker) / scale == pytest.approx(lengths["rocker"], rel=2e-3)
    assert math.dist(crank[0], rocker[0]) / scale == pytest.approx(lengths["ground"], rel=2e-3)
    bars = np.linalg.norm(np.diff(coupler, axis=0), axis=1) / scale
    assert bars == pytest.approx([lengths["coupler"], lengths["along"] - lengths["coupler"]], rel=2e-3)
    assert points(part(svg, "line"))[0, 0] > points(part(svg, "line"))[-1, 0]  # from right to left, as the crank turns


@pytest.mark.parametrize(("first", "second"), [(1.0, 1.0), (0.8, 1.3)])
def test_the_arm_is_drawn_with_its_own_lengths_and_postures(first, second):
    svg = arm(length_1=first, length_2=second)
    links = lengths(svg, "start")
    assert links[1] / links[0] == pytest.approx(second / first, rel=1e-3)
    base, elbow, tip = points(part(svg, "start"))
    assert math.atan2(base[1] - elbow[1], elbow[0] - base[0]) == pytest.approx(math.pi / 6, abs=1e-3)
    assert math.atan2(elbow[1] - tip[1], tip[0] - elbow[0]) == pytest.approx(math.pi / 3, abs=1e-3)
    x, y, radius = round_part(svg, "obstacle")
    scale = links[0] / first
    assert radius / scale == pytest.approx(0.3, rel=1e-3)
    assert [(x - base[0]) / scale, (base[1] - y) / scale] == pytest.approx([0.65, 0.8], abs=1e-3)
    assert points(part(svg, "wall"))[:, 0] == pytest.approx(base[0])
    assert {f"l₁ = {first:g}\u202fm", f"l₂ = {second:g}\u202fm"} <= set(words_of(svg))


@pytest.mark.parametrize(("first", "second"), [(0.5, 1.0), (0.9, 0.6)])
def test_the_pendulum_hangs_below_and_stands_above_its_joint_with_its_own_lengths(first, second):
    svg = pendulum_drawing(DoublePendulum(length_1=first, length_2=second))
    for kind, up in (("hanging", -1), ("upright", 1), ("swinging", 0)):
        links = lengths(svg, kind)
        assert links[1] / links[0] == pytest.approx(second / first, rel=1e-3)
        place = points(part(svg, kind))
        if up:
            assert place[:, 0] == pytest.approx(place[0, 0])
            assert up * (place[0, 1] - place[2, 1]) > 0


def test_the_boxes_of_the_car_are_as_large_as_its_masses_and_the_road_is_the_models():
    def area(svg, kind):
        place = points(part(svg, kind))
        return np.prod(np.ptp(place, axis=0))

    svg = car()
    assert area(svg, "sprung") / area(svg, "unsprung") == pytest.approx(376 / 94, rel=1e-3)
    profile = road()
    heights = -points(part(svg, "road"))[:, 1]
    own = np.interp(np.linspace(0.0, 2.8, len(heights)), np.asarray(profile.times), np.asarray(profile.values))
    assert np.corrcoef(heights, own)[0, 1] > 0.999


def test_what_is_certain_and_what_is_chosen_is_written_as_such():
    certain = QuarterCar(m_s=400.0, m_u=80.0, k_s=3e4, b_s=2000.0, eta=1.5, k_u=2e5)
    assert {"mₛ = 400 kg", "bₛ = 2000 N s/m", "η = 1.5"} <= set(words_of(car(certain)))
    assert "kₛ(ξ) = kₛ⁰ ± kₛ¹ N/m" in words_of(car(apportioned()))


def test_what_a_label_says_is_text_whatever_it_is():
    svg = sketch.drawing([sketch.label((5, 5), "a < b & c")], width=10, height=10, title='"x" < 1')
    assert words_of(svg) == ["a < b & c"]


def test_a_page_holds_a_drawing_as_markup_and_its_words_as_text():
    block = Schematic([clutch_drawing()], "Clutch <1>", "To scale & exact", "7.1")
    page = page_html(Page("t", "s", Verdict("good", "Built", "h"), [Section("The clutch", [block])]))
    assert clutch_drawing() in page
    assert "Clutch &lt;1&gt;" in page
    assert "To scale &amp; exact" in page
