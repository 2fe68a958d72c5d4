"""Pages driven in a browser: by mouse, by keyboard, on a phone, in the dark, on paper, and without scripts."""

import base64
import io

import pytest
import report_problems as given

import aleator as al
from aleator.reporting import report

pytestmark = pytest.mark.slow

CHOSEN = ".linked .chosen-name strong"


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    path = tmp_path_factory.mktemp("browser") / "report.html"
    along = al.validate_all(given.front(), 400, seed=3)
    designs, evidence = {"uOpt": given.solution()}, {"uOpt": given.evidence()}
    return report(designs, evidence, {"uOpt": given.front()}, along=along, path=path).as_uri()


def opened(browser, address, *, width=1400, height=900, scheme="light"):
    """The page, as a screen of that size shows it."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    prefer(browser, scheme)
    browser.get(address)
    return browser


def prefer(browser, scheme):
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": features})


def errors(browser):
    return [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]


def text(browser, selector):
    """What an element says, with plain spaces."""
    said = browser.execute_script("return document.querySelector(arguments[0]).innerText", selector)
    return said.replace("\u202f", " ")


def ring(browser, which=0):
    """Where the ring around the chosen point is in one of the figures."""
    return browser.execute_script(
        "const {x, y} = document.querySelectorAll('.linked .chooser .plot')[arguments[0]].data.at(-1);"
        "return [x[0], y[0]]",
        which,
    )


@pytest.mark.parametrize(("width", "height"), [(1400, 900), (360, 740)])
def test_the_page_renders_without_errors_or_sideways_scrolling(browser, address, width, height):
    opened(browser, address, width=width, height=height)
    assert browser.execute_script("return innerWidth") == width
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    drawn, rights = browser.execute_script(
        "const plots = [...document.querySelectorAll('.plot')];"
        "const drawings = [...document.querySelectorAll('.plot .main-svg')];"
        "return [plots.map(p => p.querySelectorAll('.main-svg').length),"
        " drawings.map(s => s.getBoundingClientRect().right)]"
    )
    assert drawn
    assert min(drawn) > 0
    assert max(rights) <= width + 1
    assert errors(browser) == []


def test_a_click_on_a_point_and_arrow_keys_show_one_design_after_another(browser, address):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    def press(key):
        ActionChains(browser).send_keys(key).perform()

    opened(browser, address)
    front = given.front()
    assert text(browser, CHOSEN).endswith("0.9 m")
    browser.execute_script("document.querySelector('.linked').scrollIntoView()")
    # The first trace is the entry of the legend.
    points = browser.find_elements("css selector", ".linked .chooser .plot .scatterlayer .trace:nth-child(2) .point")
    ActionChains(browser).move_to_element(points[2]).click().perform()
    assert text(browser, CHOSEN).endswith("0.2 m")
    assert f"{front.solutions[2].decisions['c.mean']:.4f} N s/m" in text(browser, ".linked .facts")
    assert ring(browser) == pytest.approx([0.2, front.objectives[2]])
    assert ring(browser, 1) == pytest.approx([0.2, front.shadow_prices[2]])
    assert browser.execute_script("return document.querySelector('.linked input:checked').value") == "2"
    # The band is that of the chosen design, with its own limit.
    mean, limits, said = browser.execute_script(
        "const p = document.querySelector('.linked .chosen .plot');"
        "return [p.data.at(-1).y, p.layout.shapes.map(s => s.y0), p.layout.annotations[0].text]"
    )
    assert mean == pytest.approx(front.solutions[2].moments["back(t)"].mean, abs=2e-3)
    assert limits == [0.2]
    assert "0.2" in said
    opened(browser, address)
    for _ in range(60):
        press(Keys.TAB)
        if browser.execute_script("return document.activeElement.type") == "radio":
            break
    assert browser.execute_script("return document.activeElement.value") == "0"
    assert browser.execute_script("return getComputedStyle(document.activeElement).outlineStyle") == "solid"
    for name in ("0.3 m", "0.2 m"):
        press(Keys.ARROW_DOWN)
        assert text(browser, CHOSEN).endswith(name)
    press(Keys.ARROW_DOWN)
    assert "infeasible" in text(browser, ".linked .facts")
    assert ring(browser, 1) == [None, None]
    assert errors(browser) == []


def brightness(browser):
    """How bright the corners of the page and of its first figure are, of 255."""
    image = pytest.importorskip("PIL.Image")
    browser.execute_script("document.querySelector('.plot').scrollIntoView()")
    place = "const r = document.querySelector('.plot').getBoundingClientRect(); return [r.left + 3, r.top + 3]"
    corner = [round(one) for one in browser.execute_script(place)]
    shot = image.open(io.BytesIO(browser.get_screenshot_as_png())).convert("L")
    return shot.getpixel((3, 3)), shot.getpixel(tuple(corner))


def test_page_and_figures_follow_the_scheme_also_when_it_changes(browser, address):
    opened(browser, address, scheme="light")
    light = brightness(browser)
    prefer(browser, "dark")
    dark = brightness(browser)
    assert min(light) > 250
    assert max(dark) < 30
    # A figure's ground is the page's own.
    assert light[0] == light[1]
    assert dark[0] == dark[1]


def test_the_printed_page_has_the_verdict_the_designs_and_no_dark_ground(browser, address):
    pypdf = pytest.importorskip("pypdf", reason="pypdf is not installed")
    opened(browser, address, scheme="dark")
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    grounds = "return ['body', '.plot'].map(s => getComputedStyle(document.querySelector(s)))"
    ground = browser.execute_script(f"{grounds}.map(s => s.backgroundColor + s.filter)")
    assert ground[0].startswith("rgb(255, 255, 255)")
    assert ground[1].endswith("none")
    told = browser.execute_script("return document.querySelector('#headline').innerText")
    prefer(browser, "light")
    printed = browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True, "printBackground": True})
    pages = pypdf.PdfReader(io.BytesIO(base64.b64decode(printed["data"]))).pages
    said = "".join("".join(page.extract_text().split()) for page in pages)
    for words in ("".join(told.split()), "Chosendesign:reach<b>&:0.9m", "Theproblemasmathematics"):
        assert words in said
    assert "Contents" not in said


def test_without_scripts_the_table_of_designs_remains(browser, address):
    browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        opened(browser, address)
        shown = {
            one: [element.is_displayed() for element in browser.find_elements("css selector", one)]
            for one in (".linked tbody tr", ".linked input", ".linked .chosen", ".plot")
        }
    finally:
        browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})
    assert shown[".linked tbody tr"] == [True] * 4
    assert not any(shown[".linked input"] + shown[".linked .chosen"] + shown[".plot"])
