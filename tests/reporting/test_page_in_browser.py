"""Pages driven in a browser: by mouse and by keyboard, and on a phone."""

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


def opened(browser, address, *, width=1400, height=900):
    """The page, as a screen of that size shows it."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.get(address)
    return browser


def scrolled(browser):
    """The page, once a reader has scrolled to its end: figures are drawn when they are about to be seen."""
    browser.execute_async_script(
        "const done = arguments[0];"
        "const step = () => {"
        "  scrollBy({top: 300, behavior: 'instant'});"
        "  if (scrollY + innerHeight < document.documentElement.scrollHeight - 1) setTimeout(step, 30);"
        "  else setTimeout(done, 200);"
        "};"
        "step();"
    )
    return browser


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
    scrolled(opened(browser, address, width=width, height=height))
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

    scrolled(opened(browser, address))
    front = given.front()
    assert text(browser, CHOSEN).endswith("0.2 m")  # the design of the page
    browser.execute_script("document.querySelector('.linked').scrollIntoView()")
    # The first trace is the entry of the legend.
    points = browser.find_elements("css selector", ".linked .chooser .plot .scatterlayer .trace:nth-child(2) .point")
    for which, name in ((0, "0.9 m"), (2, "0.2 m")):
        ActionChains(browser).move_to_element(points[which]).click().perform()
        assert text(browser, CHOSEN).endswith(name)
    assert f"{front.solutions[2].decisions['c.mean']:.4f} N s/m" in text(browser, ".linked .facts")
    assert ring(browser) == pytest.approx([0.2, front.objectives[2]])
    assert ring(browser, 1) == pytest.approx([0.2, front.shadow_prices[2]])
    assert browser.execute_script("return document.querySelector('.linked input:checked').value") == "2"
    # The band is that of the chosen design, with its own limit.
    mean, limits, said = browser.execute_script(
        "const p = document.querySelector('.linked .chosen .plot');"
        "return [Array.from(p._fullData.at(-1).y), p.layout.shapes.map(s => s.y0), p.layout.annotations[0].text]"
    )
    assert mean == pytest.approx(front.solutions[2].moments["back(t)"].mean, abs=2e-3)
    assert limits == [0.2]
    assert "0.2" in said
    scrolled(opened(browser, address)).execute_script("scrollTo({top: 0, behavior: 'instant'})")
    for _ in range(60):
        press(Keys.TAB)
        if browser.execute_script("return document.activeElement.type") == "radio":
            break
    assert browser.execute_script("return document.activeElement.value") == "2"
    assert browser.execute_script("return getComputedStyle(document.activeElement).outlineStyle") == "solid"
    for key, name in ((Keys.ARROW_UP, "0.3 m"), (Keys.ARROW_DOWN, "0.2 m")):
        press(key)
        assert text(browser, CHOSEN).endswith(name)
    press(Keys.ARROW_DOWN)
    assert "infeasible" in text(browser, ".linked .facts")
    assert ring(browser, 1) == [None, None]
    assert errors(browser) == []
