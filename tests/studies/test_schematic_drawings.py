"""The drawings of the studies: each whole and labelled."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from aleator.studies._shared import picture

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


def points(element):
    return np.array([[float(x), float(y)] for x, y in re.findall(r"(-?[\d.]+) (-?[\d.]+)", element.get("d"))])


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
