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
TIMES, HEIGHTS = np.asarray(road().times), np.asarray(road().values)


def arm(**numbers):
    return arm_drawing(TwoLinkArm(payload=1.0, obstacle=OBSTACLE, **numbers))


def car(model=None):
    return car_drawing(nominal() if model is None else model, TIMES, HEIGHTS)


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


def lengths(svg, kind):
    return np.linalg.norm(np.diff(points(part(svg, kind)), axis=0), axis=1)


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


@pytest.mark.parametrize("bars", [LENGTHS, LENGTHS | {"crank": 80.0, "rocker": 250.0}], ids=["study", "other"])
def test_the_bars_of_the_linkage_are_drawn_to_one_scale(bars):
    svg = linkage_drawing(bars)
    crank, rocker = (points(part(svg, kind)) for kind in ("crank", "rocker"))
    drawn = [*lengths(svg, "rocker"), math.dist(crank[0], rocker[0]), *lengths(svg, "coupler")]
    expected = [bars["rocker"], bars["ground"], bars["coupler"], bars["along"] - bars["coupler"]]
    assert np.array(drawn) * bars["crank"] / lengths(svg, "crank") == pytest.approx(expected, rel=2e-3)
    line = points(part(svg, "line"))
    assert line[0, 0] > line[-1, 0]  # from right to left, as the crank turns


@pytest.mark.parametrize(("first", "second"), [(1.0, 1.0), (0.8, 1.3)])
def test_the_arm_is_drawn_with_its_own_lengths_and_postures(first, second):
    svg = arm(length_1=first, length_2=second)
    links = lengths(svg, "start")
    assert links[1] / links[0] == pytest.approx(second / first, rel=1e-3)
    base, elbow, tip = points(part(svg, "start"))
    for low, high, angle in ((base, elbow, math.pi / 6), (elbow, tip, math.pi / 3)):
        assert math.atan2(low[1] - high[1], high[0] - low[0]) == pytest.approx(angle, abs=1e-3)
    x, y, radius = np.array(disc(svg, "obstacle")) * first / links[0]
    origin = base * first / links[0]
    assert [x - origin[0], origin[1] - y, radius] == pytest.approx([0.65, 0.8, 0.3], abs=1e-3)
    assert points(part(svg, "wall"))[:, 0] == pytest.approx(base[0])
    assert {f"l₁ = {first:g}\u202fm", f"l₂ = {second:g}\u202fm"} <= set(words_of(svg))


def test_the_pendulum_hangs_below_and_stands_above_its_joint_with_its_own_lengths():
    svg = pendulum_drawing(DoublePendulum(length_1=0.9, length_2=0.6))
    for kind, up in (("hanging", -1), ("upright", 1), ("swinging", 0)):
        links, place = lengths(svg, kind), points(part(svg, kind))
        assert links[1] / links[0] == pytest.approx(0.6 / 0.9, rel=1e-3)
        if up:
            assert place[:, 0] == pytest.approx(place[0, 0])
            assert up * (place[0, 1] - place[2, 1]) > 0


def test_the_car_shows_its_masses_its_road_and_what_is_certain_and_what_is_chosen():
    svg = car()
    sprung, unsprung = (np.prod(np.ptp(points(part(svg, kind)), axis=0)) for kind in ("sprung", "unsprung"))
    assert sprung / unsprung == pytest.approx(376 / 94, rel=1e-3)
    heights = -points(part(svg, "road"))[:, 1]
    own = np.interp(np.linspace(0.0, 2.8, len(heights)), TIMES, HEIGHTS)
    assert np.corrcoef(heights, own)[0, 1] > 0.999
    certain = QuarterCar(m_s=400.0, m_u=80.0, k_s=3e4, b_s=2000.0, eta=1.5, k_u=2e5)
    assert {"mₛ = 400 kg", "bₛ = 2000 N s/m", "η = 1.5"} <= set(words_of(car(certain)))
    assert "kₛ(ξ) = kₛ⁰ ± kₛ¹ N/m" in words_of(car(apportioned()))


def test_a_page_holds_a_drawing_as_markup_and_its_words_as_text():
    svg = sketch.drawing([sketch.label((5, 5), "a < b & c")], width=10, height=10, title='"x" < 1')
    assert words_of(svg) == ["a < b & c"]
    block = Schematic([svg], "Clutch <1>", "To scale & exact", "7.1")
    page = page_html(Page("t", "s", Verdict("good", "Built", "h"), [Section("The clutch", [block])]))
    assert svg in page
    assert "Clutch &lt;1&gt;" in page
    assert "To scale &amp; exact" in page
