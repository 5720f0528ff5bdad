"""Every page in a real browser: nothing on the console, no overflow, every figure drawn, light, dark and in print."""

from __future__ import annotations

import re

import pytest
from browser import browsing, found
from command import runner

pytestmark = [pytest.mark.slow, pytest.mark.skipif(found() is None, reason="no Chromium on this machine")]

VIEWS = ((400, False), (1400, False), (1400, True))      # width in pixels, dark
COMMANDS = {
    "network": ("network", "solve"),
    "solve": ("circle", "solve"),
    "montecarlo": ("plumb", "montecarlo", "--trials", 500),
    "discover": ("plumb", "discover"),
    "select": ("plumb", "select", "--keep", 8),
    "compare": ("plumb", "compare", "--starts", 1, "--draws", 5, "--seconds", 1),
    "reproduce": (None, "reproduce", "turntable"),
}
# Anything whose right edge lies outside the window and that no box of its own scrolls or hides.
OVERFLOWING = """[...document.body.querySelectorAll('*')].filter(one => {
  if (one.closest('svg') && one.tagName !== 'svg') return false;
  for (let box = one.parentElement; box; box = box.parentElement)
    if (getComputedStyle(box).overflowX !== 'visible') return false;
  const edge = one.getBoundingClientRect();
  return edge.width > 0 && (edge.right > innerWidth + 1 || edge.left < -1);
}).map(one => one.tagName + ' ' + one.className)"""
FIGURES = """[...document.querySelectorAll('figure')].map(figure => {
  for (let box = figure; box; box = box.parentElement) if (box.tagName === 'DETAILS') box.open = true;
  const drawing = figure.querySelector('svg, img, canvas'), edge = drawing.getBoundingClientRect();
  const drawn = drawing.tagName === 'IMG' ? drawing.complete && drawing.naturalWidth > 0
    : [...drawing.querySelectorAll('path, circle, use, line, polyline, rect')]
      .filter(one => one.getBoundingClientRect().width + one.getBoundingClientRect().height > 2).length > 3;
  return [figure.innerText.trim().slice(0, 40), edge.width, edge.height, drawn];
})"""
# Contrast of every text with the paper below it (WCAG 2, relative luminance).
FAINT = """(() => {
  const part = v => (v /= 255) <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const light = c => { const [r, g, b] = c.match(/[\\d.]+/g).map(Number);
    return 0.2126 * part(r) + 0.7152 * part(g) + 0.0722 * part(b); };
  const paper = light(getComputedStyle(document.body).backgroundColor);
  const texts = 'p, li, td, th, h1, h2, h3, dt, dd, summary, figcaption, svg text';
  return [...document.body.querySelectorAll(texts)].filter(one => {
    const style = getComputedStyle(one), ink = light(one.closest('svg') ? style.fill : style.color);
    return (Math.max(ink, paper) + 0.05) / (Math.min(ink, paper) + 0.05) < 4.5;
  }).map(one => one.tagName + ' ' + one.textContent.slice(0, 30));
})()"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("browser")


@pytest.fixture(scope="module")
def browser():
    with browsing() as one:
        yield one


@pytest.fixture
def page(capsys, folder, request):
    """The page of one command, made once."""
    problem, command, *words = COMMANDS[request.param]
    path = folder / request.param / "report.html"
    if not path.exists():
        calib = runner(capsys)
        if problem is not None:
            calib("example", problem, "--out", folder / problem, "--quiet")
            words = [folder / problem / "job.toml", *words]
        answer = calib(command, *words, "--out", path.parent, "--quiet")
        assert answer.status in (0, 1), answer.error
    return path


@pytest.mark.parametrize("page", COMMANDS, indirect=True)
def test_a_page_opens_without_a_word_overflows_nowhere_and_draws_every_figure(browser, page):
    for width, dark in VIEWS:
        browser.open(page, width, dark)
        assert browser.evaluate("[innerWidth, document.documentElement.scrollWidth]") == [width, width]
        assert browser.evaluate(OVERFLOWING) == []
        figures = browser.evaluate(FIGURES)
        assert figures, "a report shows something"
        assert [one for one in figures if one[1] < 200 or one[2] < 60 or not one[3]] == []
        assert browser.evaluate(OVERFLOWING) == [], "with all details opened"
        assert browser.evaluate(FAINT) == []
        assert browser.said == []
        assert [url for url in browser.requests if not url.startswith(("file:", "data:"))] == []


@pytest.mark.parametrize("page", COMMANDS, indirect=True)
def test_dark_and_light_differ_and_print_is_dark_ink_on_white_with_everything_open(browser, page):
    paper = "getComputedStyle(document.body).backgroundColor"
    seen = {}
    for dark in (False, True):
        browser.open(page, 1400, dark)
        seen[dark] = browser.evaluate(paper)
    assert seen[False] != seen[True]
    browser.open(page, 720, dark=True, media="print")
    assert browser.evaluate(paper) == "rgb(255, 255, 255)"
    assert browser.evaluate(FAINT) == []
    hidden = browser.evaluate("[...document.querySelectorAll('details figure, details table')].filter("
                              "one => one.getBoundingClientRect().height < 20).length")
    assert hidden == 0
    printed = browser.printed()
    assert printed.startswith(b"%PDF")
    assert len(re.findall(rb"/Type */Page\b", printed)) >= 1


PLACES = "[...document.querySelectorAll('.space .place')].map(one => one.getAttribute('transform'))"
INSIDE = """[...document.querySelectorAll('.space .place')].every(one => {
  const mine = one.getBoundingClientRect(), all = one.closest('svg').getBoundingClientRect();
  return mine.left >= all.left && mine.right <= all.right && mine.top >= all.top && mine.bottom <= all.bottom;
})"""
DRAWN = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))"


@pytest.mark.parametrize("page", ["network"], indirect=True)
def test_the_drawing_of_space_turns_by_keys_mouse_touch_and_buttons_and_stands_still_without_script(browser, page):
    browser.open(page, 1400)
    first = browser.evaluate(PLACES)
    assert len(first) >= 6
    assert browser.evaluate(INSIDE)

    def moved(act):
        before = browser.evaluate(PLACES)
        act()
        browser.evaluate(DRAWN)
        return browser.evaluate(PLACES) != before

    def drag(*kinds):
        x, y = browser.evaluate("(() => { const svg = document.querySelector('.space svg'); svg.scrollIntoView();"
                                "const e = svg.getBoundingClientRect(); return [e.left + 200, e.top + 100]; })()")
        for step, kind in enumerate(kinds):
            at = {"x": x + 40 * step, "y": y}
            if kind.startswith("touch"):
                browser.tell("Input.dispatchTouchEvent", type=kind, touchPoints=[] if kind == "touchEnd" else [at])
            else:
                browser.tell("Input.dispatchMouseEvent", type=kind, button="left", buttons=1, clickCount=1, **at)

    browser.evaluate("document.querySelector('.space svg').focus()")
    for key in ("ArrowLeft", "ArrowUp"):
        assert moved(lambda key=key: browser.press(key)), key
    browser.press("Home")
    browser.evaluate(DRAWN)
    assert browser.evaluate(PLACES) == first
    assert moved(lambda: drag("mousePressed", "mouseMoved", "mouseMoved", "mouseReleased"))
    assert moved(lambda: drag("touchStart", "touchMove", "touchMove", "touchEnd"))
    for name in ("nearer", "above", "front", "side"):
        assert moved(lambda name=name: browser.evaluate(f"document.querySelector('.turn [name={name}]').click()")), name
        assert name == "nearer" or browser.evaluate(INSIDE)
    assert browser.said == []

    browser.open(page, 1400, script=False)
    buttons = browser.evaluate("getComputedStyle(document.querySelector('.turn')).display")
    assert buttons == "none"
    still = browser.evaluate(PLACES)
    assert len(still) == len(first)
    assert browser.evaluate(INSIDE)
