"""Pages of nmp view in a real browser: any number of panes on one clock, colours, pictures, a phone.

    check_view.py path/to/nmp folder

Exit status 77 (skipped) if Chromium or chromedriver is missing.
"""

import base64
import glob
import os
import sys
import time

from browser import Browser, Picture
from page import PLAYER, TINY, Page, changed, check, check_messages, colours, main

H = 5e-4  # time between frames [s]
SLOW = TINY + ["time.substeps=10", "time.frames=40"]  # frames of 1 ms, a third shorter
HELD = TINY + ["contact.ground='none'", "pins.planes=[[0, 0, 1, 0.49]]", "initial.clearance='none'",
               "initial.random_orientation=false", "material.E=5e4"]  # fmt: skip


def make_pages(program):
    """Files of pages by name."""
    data = program.generate("data", TINY)
    slow, held = program.generate("slow", SLOW), program.generate("held", HELD)
    methods = ["--methods", "neo-hookean,stvk,soft=projective"]
    pages = {
        "four": ["--data", data, "--trajectory", "0,1", *methods],
        "clocks": [data, "slow=" + slow],
        "pins": [held],
    }
    for name, arguments in pages.items():
        pages[name] = program.path(name + ".html")
        program.run("view", *arguments, "-o", pages[name], "--force")
    return pages


def moments(page):
    """What every pane says, and the time."""
    return page.text(".time b")[0], page.text(".player-name small")


def check_panes(page):
    browser = page.browser
    page.window(1400, 900)
    loaded = "return performance.getEntriesByType('resource').length"
    check(browser.run(loaded) == 0, "nothing is loaded from elsewhere")
    page.focus()
    first = page.panes("four_first")
    names = ["recorded", "neo-hookean", "stvk", "soft"]
    check(page.text(".player-pane .player-name span") == names, "a pane for every motion")
    check(len(first) == 4, "four panes")
    for name, pane in zip(names, first):
        check(colours(pane) > 50, f"the pane of {name} is not blank, {colours(pane)} colours")

    # 1. One clock: all of them move, by the slider too.
    browser.run(
        "const s = document.querySelector('.player-time input'); s.value = arguments[0];"
        "s.dispatchEvent(new Event('input'))", 100 * H
    )
    page.settle()
    moved = page.panes("four_error")
    for name, before, after in zip(names, first, moved):
        check(changed(before, after) > 0.02, f"the slider moves {name}")
    now, notes = moments(page)
    check(now == "50.0 ms" and page.frame() == 100, f"at frame 100: {now}")
    check(notes[0] == "reference x*", "the record is the reference")
    check(all(note.startswith("RMSE") for note in notes[1:]), f"and the others have errors: {notes}")
    t0 = page.state()["t"]
    page.key("+")
    page.key(" ")
    time.sleep(0.3)
    page.key(" ")
    check(page.state()["t"] > t0, "it plays")

    # 2. Colours.
    page.seek(100 * H)
    seen = {}
    for k, name in enumerate(["error", "det", "stress", "speed", "plain"]):
        page.key(str(k + 1))
        seen[name] = page.panes("four_" + name)
        pressed = page.text(".segments button[aria-pressed=true]")[0]
        check(pressed == {"det": "det F"}.get(name, name), f"the button of {name} is pressed")
    for before, after in zip(list(seen), list(seen)[1:]):
        apart = changed(seen[before][3], seen[after][3])
        check(apart > 0.1, f"{after} is another picture than {before}, {apart:.2f}")
    check(changed(seen["plain"][0], seen["plain"][1]) > 0.1, "every motion has its own plain colour")

    # 3. One over the other.
    page.key("1")
    page.key("o")
    check(len(page.panes("four_overlay")) == 1, "o puts them into one pane")
    check(page.text(".player-name span") == names, "which names them all")
    drawn = ["net", "hidden", "hidden", "solid"]
    check(page.text(".player-name em") == drawn, "and says which is solid and which a net")
    bare = page.panes()
    page.key("e")
    check(changed(bare[0], page.panes()[0]) > 0.005, "e adds the edges of the solid one")
    page.key("e")
    check(changed(bare[0], page.panes()[0]) < 0.001, "and takes them off")
    browser.run("document.querySelectorAll('.player-name')[1].click()")
    page.settle()
    check(page.state()["chosen"] == 1, "a click on a name shows that one")
    page.key("o")
    check(len(page.panes()) == 4, "o brings the panes back")

    # 4. At the end: without loop it stops there.
    page.key("l")
    page.seek(119.5 * H)
    page.key(" ")
    time.sleep(0.6)
    state = page.state()
    check(not state["playing"] and abs(state["t"] - 120 * H) < 1e-9, "without loop it stops")
    page.key("l")

    # 5. The other trajectory.
    before = page.panes()
    notes = browser.run(
        f"{PLAYER}.choose_track(1);"
        "return [...document.querySelectorAll('.player-name small')].map(e => e.textContent)"
    )
    check(all(notes), f"panes say their errors at once: {notes}")
    page.settle()
    check(changed(before[0], page.panes()[0]) > 0.05, "the other trajectory is another picture")


def check_picture(page, folder):
    """What the button saves, and the same from a script."""
    page.browser.devtools("Page.setDownloadBehavior", behavior="allow", downloadPath=folder)
    for old in glob.glob(os.path.join(folder, "nmp-*.png")):
        os.remove(old)
    page.window(1400, 900)
    page.focus()
    page.seek(100 * H)
    page.key("3")
    page.key("s")
    wanted = os.path.join(folder, "nmp-stress-50.0ms.png")
    for _ in range(100):
        if os.path.exists(wanted):
            break
        time.sleep(0.05)
    else:
        check(False, f"s saves {wanted}, there is {glob.glob(os.path.join(folder, '*.png'))}")
        return
    time.sleep(0.1)
    with open(wanted, "rb") as file:
        picture = Picture(file.read())
    left, top, right, bottom = page.box(".player-view canvas")
    check(picture.width == round(right - left), "the picture is as wide as the view")
    check(picture.height > round(bottom - top), "and has room for the scale below")
    half = picture.width // 2
    for x, y in ((0, 0), (half, 0), (0, 300), (half, 300)):
        pane = list(picture.pixels(x + 60, y + 40, x + half - 60, y + 290))
        check(colours(pane) > 50, f"the pane at {x}, {y} is in the picture")
    foot = list(picture.pixels(half, picture.height - 50, picture.width, picture.height))
    check(colours(foot) > 100, "the scale is in the picture")
    script = page.browser.run(f"return {PLAYER}.picture().toDataURL('image/png')")
    check(len(base64.b64decode(script.split(",")[1])) > 10000, "a script gets a picture, too")


def check_resize(page):
    """The canvas has the view's size when it is painted, not a frame later: no picture is stretched."""
    page.window(1400, 900)
    page.browser.run(
        "window.ratios = []; const c = document.querySelector('.player-view canvas');"
        "new ResizeObserver(() => window.ratios.push([c.width / c.clientWidth,"
        " c.height / c.clientHeight])).observe(document.querySelector('.player-view'))"
    )
    for width, height, scale in ((1000, 900, 1), (1300, 640, 2), (390, 844, 2)):
        page.browser.run("window.ratios = []")
        page.window(width, height, scale)
        ratios = page.browser.run("return window.ratios")
        fits = all(abs(r - scale) < 0.01 for both in ratios for r in both)
        check(ratios and fits, f"pixels per CSS pixel in a window of {width} x {height}: {ratios}")


def check_clocks(page):
    """Motions with different times between frames, of which one ends before the other."""
    page.window(1400, 900)
    page.focus()
    page.seek(40.5 * 1e-3)
    now, notes = moments(page)
    check(now == "40.5 ms" and page.frame() == 81, f"the first one's frames are counted: {now}")
    check("ended after frame 40" in notes[1], f"the second one is over: {notes}")
    page.seek(20e-3)
    check(moments(page)[1][1].startswith("RMSE"), "errors at the same time")
    page.key("\ue014")  # right
    check(abs(page.state()["t"] - 20.5e-3) < 1e-9, "a step goes to the next frame of any motion")
    page.key("4")
    panes = page.panes("clocks")
    check(changed(*panes) < 0.02, f"both show the same moment, {changed(*panes):.3f}")



def check_address(browser, path, folder):
    """What a link says is shown: for pictures by chromium --screenshot."""
    shown = "#time=0.05&colour=stress&view=overlay&edges=0&track=1&motion=2"
    page = Page(browser, path + shown, folder)
    state = page.state()
    check(abs(state["t"] - 0.05) < 1e-9 and state["channel"] == 2, f"time and colour: {state}")
    check(state["overlay"] and not state["edges"] and state["track"] == 1, f"the view: {state}")
    check(state["chosen"] == 2, f"the motion that is solid: {state}")
    about = page.text("[data-about]")
    check(about[0].startswith("val/001 \u00b7 0.06 s \u00b7 "), f"the line under the title: {about}")


def check_phone(page, name, n_panes):
    for dark in (False, True):
        page.window(390, 844, 2, dark=dark)
        check(page.fits(), f"{name}: a phone needs no horizontal scrolling")
        panes = page.panes(f"{name}_phone" + ("_dark" if dark else ""), scale=2)
        check(len(panes) == n_panes, f"{name}: all panes on a phone")
        for pane in panes:
            check(colours(pane) > 50, f"{name}: no pane is blank on a phone")
    sizes = page.browser.run(
        "return [...document.querySelectorAll('.player *')].filter(e => e.children.length === 0 &&"
        " e.textContent.trim() && e.offsetWidth).map(e => parseFloat(getComputedStyle(e).fontSize))"
    )
    check(min(sizes) >= 12, f"{name}: no text is smaller than 12 px, {min(sizes)}")
    if n_panes > 1:  # one over the other, names and body apart
        page.browser.run("[...document.querySelectorAll('.segments button')].at(-1).click()")
        page.settle()
        page.keep(f"{name}_phone_overlay")
        names, pane = page.box(".player-choice"), page.box(".player-pane")
        check(names[3] <= pane[1] + 1, f"{name}: names do not cover the body, {names} {pane}")
        check(page.fits(), f"{name}: the names fit on a phone")
        page.browser.run("[...document.querySelectorAll('.segments button')].at(-2).click()")
        page.settle()
    # One finger turns, in both directions; two come nearer.
    home = page.state()
    left, top, right, bottom = page.box(".player-view")
    x, y = (left + right) / 2, (top + bottom) / 2

    def touch(kind, *points):
        touches = [{"x": px, "y": py, "id": i} for i, (px, py) in enumerate(points)]
        page.browser.devtools("Input.dispatchTouchEvent", type=kind, touchPoints=touches)
        page.settle()

    touch("touchStart", (x, y))
    touch("touchMove", (x + 40, y + 30))
    touch("touchEnd")
    turned = page.state()
    check(turned["azimuth"] != home["azimuth"], f"{name}: a finger turns")
    check(turned["elevation"] != home["elevation"], f"{name}: up and down, too")
    touch("touchStart", (x - 20, y), (x + 20, y))
    touch("touchMove", (x - 60, y), (x + 60, y))
    touch("touchEnd")
    check(page.state()["distance"] < 0.7 * home["distance"], f"{name}: two fingers come nearer")


def checks(program, folder):
    pages = make_pages(program)
    with Browser() as browser:
        page = Page(browser, pages["four"], folder)
        check_panes(page)
        check_picture(page, folder)
        check_resize(page)
        check_phone(page, "four", 4)
        check_messages(browser, "four panes")
        check_clocks(Page(browser, pages["clocks"], folder))
        check_address(browser, pages["four"], folder)
        pins = Page(browser, pages["pins"], folder)
        check(pins.text(".pin") == ["pinned vertices"], "pins are explained")
        disabled = "return document.querySelectorAll('.segments button:disabled').length"
        check(pins.browser.run(disabled) == 1, "one motion alone has no errors")
        check_phone(pins, "pins", 1)
        check_messages(browser, "other pages")
    with Browser(extra_flags=["--force-prefers-reduced-motion"]) as browser:
        page = Page(browser, pages["pins"], folder)
        check(not page.state()["loop"] and not page.state()["playing"], "reduced motion: no loop")


if __name__ == "__main__":
    sys.exit(main(checks))
