"""Contrast of everything on a page with its ground, on light and on dark screens (WCAG 2.2, 1.4.3 and 1.4.11)."""

import re
from importlib import resources

import numpy as np
import pytest

from aleator.reporting import _style

CSS = (resources.files("aleator.reporting") / "templates" / "page.css").read_text(encoding="utf-8")
LIGHT, DARK = (
    dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", block)) for block in re.findall(r":root \{(.*?)\n *\}", CSS, re.S)
)
TEXT = [(ink, ground) for ink in ("ink", "soft", "muted", "link") for ground in ("paper", "wash")]
TONES = [(one, ground) for one in ("good", "caution", "bad") for ground in ("paper", f"{one}-wash")]


def channels(colour):
    return np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])


def contrast(first, second):
    """The contrast ratio of two colours of three channels."""
    linear = [np.where(one <= 0.04045, one / 12.92, ((one + 0.055) / 1.055) ** 2.4) for one in (first, second)]
    low, high = sorted(float(one @ [0.2126, 0.7152, 0.0722]) for one in linear)
    return (high + 0.05) / (low + 0.05)


def turned(colour):
    """A colour of a figure on a dark screen: by the filters of the page, as the standard of filters defines them."""
    invert = float(re.search(r"invert\(([\d.]+)\)", CSS)[1])
    assert "hue-rotate(180deg)" in CSS
    inverted = invert + colour * (1 - 2 * invert)
    weights = np.array([0.213, 0.715, 0.072])
    # By half a turn, of which the cosine is -1 and the sine 0.
    return np.clip(2 * np.outer(np.ones(3), weights) @ inverted - inverted, 0, 1)


@pytest.mark.parametrize("scheme", [LIGHT, DARK], ids=["light", "dark"])
def test_text_contrasts_with_its_ground(scheme):
    faint = [pair for pair in TEXT + TONES if contrast(*(channels(scheme[one]) for one in pair)) < 4.5]
    assert faint == []


def test_both_schemes_name_the_same_colours_and_no_rule_has_one_of_its_own():
    assert LIGHT.keys() == DARK.keys()
    rules = re.sub(r":root \{.*?\n *\}", "", CSS, flags=re.S)
    assert re.findall(r"#[0-9a-fA-F]{3,8}\b", rules) == []


def test_texts_and_lines_in_figures_contrast_with_their_ground_on_light_and_on_dark():
    texts, white = (_style.INK, _style.MUTED, _style.LIMIT, _style.ALARM), np.ones(3)
    for colour, least in ((one, 4.5 if one in texts else 3.0) for one in (*texts, *_style._COLOURS)):
        assert contrast(channels(colour), white) >= least
        assert contrast(turned(channels(colour)), turned(white)) >= least
    # The ground of figures on a dark screen is that of the page.
    np.testing.assert_allclose(turned(white), channels(DARK["paper"]), atol=0.5 / 255)
