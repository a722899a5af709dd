"""A report in a real browser: nothing fails, the player draws, keys and pointer do what they say.

    check_report.py path/to/nmp folder

Makes a small report with nmp, opens it in headless Chromium as a file and keeps screenshots in the
folder. Exit status 77 (skipped) if Chromium or chromedriver is missing.
"""

import array
import base64
import json
import math
import os
import sys
import time

from browser import Browser
from page import PLAYER, TINY, Page, changed, check, check_messages, colours, main

QUICK = """train.constitutive.iterations=150 train.constitutive.batch=256
    train.integration.iterations=2 train.integration.batch=64 train.integration.fit_window=20
    train.integration.window_start=4 train.integration.window_end=8 train.joint.iterations=1
    train.joint.reset_start=8 train.joint.reset_end=8""".split()
H = 5e-4  # time between frames [s]


def make_report(program):
    data, model, page = (program.path(name) for name in ("data", "m.safetensors", "r.html"))
    settings = [part for key in QUICK for part in ("--set", key)]
    program.generate("data", TINY)
    program.run("train", "fast", "--data", data, "-o", model, "--force", *settings)
    program.run("report", "--model", model, "--data", data, "-o", page, "--force")
    return page


def make_large_page(page, folder, n=100, n_frames=40):
    """The page with a body of n x n vertices, a sphere that waves, in place of its own."""
    with open(page, encoding="utf-8") as file:
        html = file.read()
    begin = html.index("data-player>") + len('data-player><script type="application/json">')
    end = html.index("</script>", begin)
    doc = json.loads(html[begin:end])

    triangles, edges = array.array("I"), set()
    for i in range(n - 1):
        for j in range(n):
            a, b, c, d = i * n + j, i * n + (j + 1) % n, (i + 1) * n + j, (i + 1) * n + (j + 1) % n
            triangles.extend((a, c, b, b, c, d))
            edges.update({(min(p, q), max(p, q)) for p, q in ((a, b), (a, c), (b, c), (c, d), (b, d))})
    data = [bytearray(), bytearray()]
    for t in range(n_frames):
        for which in range(2):
            frame = array.array("B")
            for i in range(n):
                theta = math.pi * (i + 0.5) / n
                for j in range(n):
                    phi = 2 * math.pi * j / n
                    r = 24000 + 4000 * math.sin(5 * theta + 0.3 * t + 0.1 * which)
                    x = (r * math.sin(theta) * math.cos(phi), r * math.sin(theta) * math.sin(phi))
                    for value in (*x, r * math.cos(theta)):
                        q = int(32768 + value)
                        frame.extend((q & 255, q >> 8))
                    frame.extend((i * 255 // n, j * 255 // n))
            data[which] += frame.tobytes()
            data[which] += bytes(v for i in range(n * n) for v in ((i + 7 * t) % 256, i % 256))
    flat = array.array("I", (v for edge in sorted(edges) for v in edge))
    doc["bodies"][0].update(
        vertices=n * n,
        pinned=[0, n * n - 1],
        triangles=base64.b64encode(triangles.tobytes()).decode(),
        edges=base64.b64encode(flat.tobytes()).decode(),
    )
    track = doc["tracks"][0]
    for which, motion in enumerate(track["motions"]):
        # The second one ends halfway.
        last = n_frames if which == 0 else n_frames // 2 + 1
        motion.update(low=[-1, -1, 0], size=[2, 2, 2], frames=list(range(last)))
        motion.update(rmse=[[None, 1e-3][which]] * last, diverged=which == 1)
        motion.update(data=base64.b64encode(bytes(data[which][: last * 10 * n * n])).decode())
    doc["tracks"] = [track]
    large = os.path.join(folder, "large.html")
    with open(large, "w", encoding="utf-8") as file:
        file.write(html[:begin] + json.dumps(doc) + html[end:])
    return large


def check_page(page):
    browser = page.browser
    page.window(1200, 900)
    check(browser.run(f"return {PLAYER}.webgl"), "WebGL2 in software")
    check(
        browser.run("return performance.getEntriesByType('resource').length") == 0,
        "nothing is loaded from elsewhere",
    )
    check(page.fits(), "no horizontal scrolling")

    # 1. Both panes show something, and scrubbing changes it.
    page.focus()
    first = page.panes("light_first")
    for pane, name in zip(first, ("recorded", "predicted")):
        check(colours(pane) > 50, f"the {name} pane is not blank, {colours(pane)} colours")
    page.seek(90 * H)
    error = page.panes("light_error")
    for before, after, name in zip(first, error, ("recorded", "predicted")):
        check(changed(before, after) > 0.02, f"scrubbing changes the {name} pane")
    check(page.text(".frame b") == ["90 / 120"], "frame")
    check(page.text(".time b") == ["45.0 ms"], "time")
    check(page.text(".player-name span") == ["recorded", "predicted"], "names of the motions")
    notes = page.text(".player-name small")
    check(notes[0] == "reference x*" and "RMSE" in notes[1] and "m" in notes[1], f"RMSE: {notes}")

    # 2. Colours.
    check(page.text(".player-scale > span") == ["error |x \u2212 x*| [m]"], "the scale of errors")
    pictures = {"error": error}
    for key, name, title in (
        ("2", "det", "det F [\u2013]"),
        ("3", "stress", "von Mises stress ["),
        ("4", "speed", "speed [m/s]"),
    ):
        page.key(key)
        pictures[name] = page.panes("light_" + name)
        check(page.text(".player-scale > span")[0].startswith(title), f"the scale of {name}")
    names = list(pictures)
    for before, after in zip(names, names[1:]):
        for pane in range(2):
            apart = changed(pictures[before][pane], pictures[after][pane])
            check(apart > 0.1, f"{after} has colours of its own in pane {pane}, {apart:.2f}")
    page.key("5")
    plain = page.panes("light_plain")
    check(changed(plain[1], pictures["speed"][1]) > 0.1, "plain colours")
    check(changed(plain[0], error[0]) < 0.01, "the reference is plain where errors are shown")
    page.key("1")
    check(changed(error[1], page.panes()[1]) < 0.01, "1 brings the error back")

    # 3. Keys.
    page.key("\ue010")  # End
    check(page.frame() == 120, "End goes to the last frame")
    page.key("\ue012")  # left
    stride = browser.run(f"return {PLAYER}.document.tracks[0].motions[0].frames[1]")
    check(page.frame() == 120 - stride, "left goes back by a stored frame")
    page.key("\ue011")  # Home
    page.key("\ue014")  # right
    check(page.frame() == stride, "right goes on by a stored frame")
    page.key("\ue014", shift=True)
    check(page.frame() == 11 * stride, "with Shift by ten")
    page.key(" ")
    time.sleep(0.4)
    playing = page.state()
    page.key(" ")
    check(playing["playing"] and playing["t"] > 11.5 * stride * H, "space plays")
    paused = page.state()
    time.sleep(0.2)
    check(not paused["playing"] and page.state()["t"] == paused["t"], "space pauses")
    page.key("?")
    shown = "return !document.querySelector('.player-help').hidden"
    check(browser.run(shown), "? shows the keys")
    page.keep("light_help")
    page.key("?")
    check(not browser.run(shown), "? hides them")
    page.seek(90 * H)
    page.key("e")
    check(changed(error[0], page.panes()[0]) > 0.02, "e takes the edges off")
    page.key("e")
    page.key("o")
    check(page.state()["overlay"], "o overlays")
    overlay = page.panes("light_overlay")
    check(len(overlay) == 1, "one pane")
    check(colours(overlay[0]) > 50, "with something in it")
    check(page.state()["chosen"] == 1, "the prediction, with the record's edges")
    page.key("n")
    check(changed(page.panes()[0], overlay[0]) > 0.05, "n changes them")
    page.key("o")

    # 4. Pointer.
    home = page.state()
    left, top, right, bottom = page.box(".player-view")
    middle = [int((left + right) / 2), int((top + bottom) / 2)]
    browser.drag(middle, (120, 60))
    page.settle()
    turned = page.state()
    check(turned["azimuth"] != home["azimuth"], "dragging turns")
    check(turned["elevation"] != home["elevation"], "in both directions")
    check(changed(error[1], page.panes()[1]) > 0.05, "and the picture with it")
    scrolled = browser.run("return window.scrollY")
    browser.wheel(middle, -200)
    page.settle()
    check(page.state()["distance"] < home["distance"], "the wheel comes nearer")
    check(browser.run("return window.scrollY") == scrolled, "without scrolling the page")
    page.key("r")
    check(abs(page.state()["distance"] - home["distance"]) < 1e-9, "r resets the view")
    check(changed(error[1], page.panes()[1]) < 0.01, "to the same picture")

    # 5. The other trajectory.
    browser.run(
        "const s = document.querySelector('.player-settings select'); s.value = 1;"
        "s.dispatchEvent(new Event('change'))"
    )
    page.settle()
    check(page.state()["track"] == 1, "the selector changes the trajectory")
    check(changed(error[0], page.panes()[0]) > 0.05, "and the picture")

    # 6. A lost context comes back.
    browser.run(
        "const gl = document.querySelector('.player canvas').getContext('webgl2');"
        "window.lose = gl.getExtension('WEBGL_lose_context'); window.lose.loseContext();"
    )
    page.settle()
    browser.run("window.lose.restoreContext()")
    time.sleep(0.2)
    page.settle()
    check(colours(page.panes()[1]) > 50, "the picture is back after a lost context")

    # 7. Dark, and a phone.
    page.window(1200, 900, dark=True)
    dark = page.panes("dark_error")
    check(all(colours(pane) > 50 for pane in dark), "both panes in the dark")
    page.key("2")
    page.keep("dark_det")
    page.window(390, 844, 2)
    check(page.fits(), "every control is inside a phone's window, without scrolling")
    for pane in page.panes("phone", scale=2):
        check(colours(pane) > 50, "both panes on a phone")
    page.window(390, 844, 2, dark=True)
    page.keep("phone_dark")

    # 8. Read-outs of the plots, and the page as a whole.
    page.window(1200, 900)
    tips = browser.run(
        "let n = 0; for (const svg of document.querySelectorAll('figure[data-plot] svg[data-left]')) {"
        " const b = svg.getBoundingClientRect(); if (!b.width) continue;"
        " svg.dispatchEvent(new PointerEvent('pointermove', {clientX: b.left + b.width / 2,"
        " clientY: b.top + b.height / 2}));"
        " n += !svg.closest('figure').querySelector('.tip').hidden; } return n"
    )
    check(tips >= 10, f"plots have read-outs, {tips}")
    height = browser.run(
        "document.querySelectorAll('.tip').forEach(t => { t.hidden = true; });"
        "return document.documentElement.scrollHeight"
    )
    page.window(1200, height)
    page.keep("page")


def check_speed(page):
    """Milliseconds of script per drawn frame of 10,000 vertices, and frames per second here."""
    page.window(1200, 900)
    page.focus()
    for pane in page.panes("large"):
        check(colours(pane) > 50, "the large body is drawn")
    script = page.browser.run(
        f"const p = {PLAYER}; p.render();"
        "p.stats.draws = p.stats.script_ms = 0;"
        f"for (let i = 0; i < 20; ++i) {{ p.state.t = {1.37 * H} * i; p.render(); }}"
        "return p.stats.script_ms / p.stats.draws"
    )
    page.key("e")
    page.key(" ")
    page.browser.run(f"{PLAYER}.stats.draws = 0")
    time.sleep(1)
    frames = page.browser.run(f"return {PLAYER}.stats.draws")
    page.key(" ")
    page.seek(30 * H)
    held = page.text(".player-name small")[1]
    check("diverged after frame 20" in held, f"a held prediction is said to be so: {held}")
    load = page.browser.run(f"return {PLAYER}.stats.load_ms")
    print(
        f"10,000 vertices: {script:.2f} ms of script a frame, {load:.0f} ms to load 61 frames; "
        f"{frames} frames a second in software"
    )
    check(script < 16, f"script takes {script:.1f} ms a frame")


def check_without_webgl(page):
    page.window(1200, 900)
    check(not page.browser.run(f"return {PLAYER}.webgl"), "no WebGL2 with --disable-3d-apis")
    said = page.browser.run("return document.querySelector('.player-message').textContent")
    check("no WebGL2" in said, "the player says what it lacks")
    page.keep("without_webgl")


def checks(program, folder):
    report = make_report(program)
    large = make_large_page(report, folder)
    with Browser() as browser:
        check_page(Page(browser, report, folder))
        check_messages(browser, "report")
        check_speed(Page(browser, large, folder))
        check_messages(browser, "large page")
    with Browser(extra_flags=["--disable-3d-apis"]) as browser:
        check_without_webgl(Page(browser, report, folder))
        check_messages(browser, "without WebGL2")


if __name__ == "__main__":
    sys.exit(main(checks))
