"""The drawings of the studies: each whole and labelled, with the numbers and to the scale of its model."""

import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from aleator.reporting import given
from aleator.studies import four_bar, suspension, swing_up, two_link_arm
from aleator.studies._shared import picture
from aleator.studies.clutch import MEANS
from aleator.studies.four_bar._elimination import posture_of

SVG = "{http://www.w3.org/2000/svg}"


FILES = {
    "clutch": "clutch/clutch.svg",
    "arm": "two_link_arm/arm.svg",
    "pendulum": "swing_up/pendulum.svg",
    "car": "suspension/car.svg",
    "linkage": "four_bar/linkage.svg",
}
SYMBOLS = {
    "clutch": ["a", "b", "c", "e", "γ", "hub", "roller", "ring"],
    "arm": ["q₁, τ₁", "q₂, τ₂", "wall", "obstacle", "target", "start, M(ξ)"],
    "pendulum": ["q₁, τ₁", "q₂ (free)", "m₂(ξ)", "g", "start", "target"],
    "car": ["zₛ", "zᵤ", "road", "mᵤ = 94 kg", "mₛ(ξ) = 376 ± 47 kg", "kₛ(ξ) = kₛ⁰ ± 3750 N/m"],
    "linkage": ["θ, τ", "crank", "coupler", "rocker", "tool"],
}
DRAWINGS = {name: picture(place) for name, place in FILES.items()}


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
    drawing = DRAWINGS[name]
    tree = ElementTree.fromstring(drawing)
    assert set(SYMBOLS[name]) <= set(words_of(drawing))
    assert not re.search("#[0-9a-f]{3}", drawing)  # in the colour of the page
    _, _, width, height = map(float, tree.get("viewBox").split())
    for one in tree.iter(f"{SVG}path"):
        assert np.all((points(one) >= 0) & (points(one) <= [width, height]))
    for one in tree.iter(f"{SVG}text"):
        reach = 0.55 * float(one.get("font-size")) * len(one.text)  # about the width of a word
        left = float(one.get("x")) - reach * {"start": 0.0, "middle": 0.5, "end": 1.0}[one.get("text-anchor")]
        assert 0 <= left <= left + reach <= width
        assert 8 <= float(one.get("y")) <= height


def test_the_roller_touches_hub_and_ring_where_the_closed_form_says():
    svg, (a, c, e) = DRAWINGS["clutch"], MEANS.values()
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


def bars(svg, kind):
    """The lengths of the bars of a chain."""
    return np.hypot(*np.diff(points(part(svg, kind)), axis=0).T)


def test_numbers_and_proportions_are_those_of_the_models():
    car, said = suspension.nominal(), words_of(DRAWINGS["car"])
    for symbol, one, unit in (("k", car.k_s, "N/m"), ("b", car.b_s, "N s/m")):
        assert (
            f"{symbol}ₛ(ξ) = {symbol}ₛ⁰ ± {given(float(one.parameters['half_width']), unit)}".replace("\u202f", " ")
            in said
        )
    for symbol, one, unit in (("mₛ", car.m_s, " kg"), ("kᵤ", car.k_u, " N/m"), ("η", car.eta, "")):
        mean, half = (given(float(one.parameters[name])) for name in ("mean", "half_width"))
        assert f"{symbol}(ξ) = {mean} ± {half}{unit}" in said
    arm, pendulum = two_link_arm.TwoLinkArm(payload=1.0), swing_up.DoublePendulum()
    for name, model, chains in (("arm", arm, ("start", "target")), ("pendulum", pendulum, ("hanging", "swinging"))):
        lengths = np.array([model.length_1, model.length_2])
        for sign, length in zip("₁₂", lengths, strict=True):
            assert f"l{sign} = {given(length, 'm')}" in words_of(DRAWINGS[name])
        for chain in chains:
            drawn = bars(DRAWINGS[name], chain)
            np.testing.assert_allclose(drawn / drawn.sum(), lengths / lengths.sum(), atol=1e-3)
    posture = posture_of(four_bar.LENGTHS, np.array(2.3))
    coupler = np.hypot(*np.diff([posture.crank_pin, posture.rocker_pin, posture.tool], axis=0).T)
    drawn = [*bars(DRAWINGS["linkage"], "crank"), *bars(DRAWINGS["linkage"], "coupler")]
    lengths = np.array([four_bar.LENGTHS["crank"], *coupler])
    np.testing.assert_allclose(np.array(drawn) / sum(drawn), lengths / lengths.sum(), atol=1e-3)
