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
import subprocess
import sys
import time

from browser import Browser, Picture, find_programs

TINY = """mesh.vertices_per_edge=5 time.frames=120 time.dt=1e-4 time.substeps=5
    initial.clearance=0.02 dataset.train=2 dataset.validation=2""".split()
QUICK = """train.constitutive.iterations=150 train.constitutive.batch=256
    train.integration.iterations=2 train.integration.batch=64 train.integration.fit_window=20
    train.integration.window_start=4 train.integration.window_end=8 train.joint.iterations=1
    train.joint.reset_start=8 train.joint.reset_end=8""".split()

PLAYER = "document.querySelector('[data-player]').nmpPlayer"
failures = []


def check(truth, what):
    if not truth:
        failures.append(what)
        print("FAILED: " + what, flush=True)


def make_report(nmp, folder):
    def run(*arguments):
        result = subprocess.run([nmp] + list(arguments), stdout=subprocess.DEVNULL, stderr=log)
        if result.returncode != 0:
            sys.exit(f"nmp {' '.join(arguments)} failed; see {log.name}")

    def settings(keys):
        return [part for key in keys for part in ("--set", key)]

    log = open(os.path.join(folder, "nmp.log"), "w", encoding="utf-8")
    data, model, page = (os.path.join(folder, name) for name in ("data", "m.safetensors", "r.html"))
    run("data", "gen", "cube", "-o", data, "--force", *settings(TINY))
    run("train", "fast", "--data", data, "-o", model, "--force", *settings(QUICK))
    run("report", "--model", model, "--data", data, "-o", page, "--force")
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
    data = bytearray()
    for t in range(n_frames):
        frames = [array.array("B"), array.array("B")]
        for which, frame in enumerate(frames):
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
        data += frames[0].tobytes() + frames[1].tobytes() + bytes((i + 7 * t) % 256 for i in range(n * n))
    doc["vertices"], doc["pinned"] = n * n, [0, n * n - 1]
    doc["triangles"] = base64.b64encode(triangles.tobytes()).decode()
    flat = array.array("I", (v for edge in sorted(edges) for v in edge))
    doc["edges"] = base64.b64encode(flat.tobytes()).decode()
    track = doc["tracks"][0]
    track.update(low=[-1, -1, 0], size=[2, 2, 2], stride=1, frames=list(range(n_frames)))
    track.update(rmse=[1e-3] * n_frames, data=base64.b64encode(bytes(data)).decode(), held=20)
    doc["tracks"] = [track]
    large = os.path.join(folder, "large.html")
    with open(large, "w", encoding="utf-8") as file:
        file.write(html[:begin] + json.dumps(doc) + html[end:])
    return large


class Page:
    """A page with a player, in a window of a given size."""

    def __init__(self, browser, path, folder):
        self.browser, self.folder = browser, folder
        browser.open(path)
        self.settle()

    def settle(self):
        """Until what was asked for is on the screen."""
        self.browser.run_async(
            "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() =>"
            " setTimeout(done, 60)));"
        )

    def window(self, width, height, scale=1, dark=False):
        self.browser.devtools(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=scale, mobile=width < 500,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.browser.devtools("Emulation.setEmulatedMedia", features=[scheme])
        self.settle()
        self.browser.run(
            "document.querySelector('[data-player]').scrollIntoView({block: 'start'});"
            "window.scrollBy(0, -16);"
        )
        self.settle()

    def focus(self):
        self.browser.run("document.querySelector('.player-view').focus({preventScroll: true})")

    def state(self):
        return self.browser.run(f"return Object.assign({{}}, {PLAYER}.state, {PLAYER}.camera)")

    def key(self, key, shift=False):
        self.browser.key(key, shift)
        self.settle()

    def seek(self, t):
        self.browser.run(f"{PLAYER}.seek(arguments[0])", t)
        self.settle()

    def box(self, selector):
        return self.browser.run(
            "const b = document.querySelector(arguments[0]).getBoundingClientRect();"
            "return [b.left, b.top, b.right, b.bottom]",
            selector,
        )

    def keep(self, name):
        """A screenshot in the folder."""
        png = self.browser.screenshot()
        with open(os.path.join(self.folder, name + ".png"), "wb") as file:
            file.write(png)
        return png

    def panes(self, name=None, stacked=False, scale=1):
        """Middles of the two panes as lists of pixels."""
        picture = Picture(self.keep(name) if name else self.browser.screenshot())
        left, top, right, bottom = (scale * v for v in self.box(".player-view"))
        w, h = right - left, bottom - top
        panes = []
        for k in range(2):
            x0, y0 = (left, top + k * h / 2) if stacked else (left + k * w / 2, top)
            pw, ph = (w, h / 2) if stacked else (w / 2, h)
            panes.append(list(picture.pixels(x0 + pw * 0.2, y0 + ph * 0.2, x0 + pw * 0.8, y0 + ph * 0.9)))
        return panes


def colours(pane):
    return len(set(pane))


def changed(a, b):
    """Part of the pixels that differ visibly."""
    return sum(sum(abs(p - q) for p, q in zip(x, y)) > 24 for x, y in zip(a, b)) / max(1, len(a))


def check_page(page):
    browser = page.browser
    page.window(1200, 900)
    check(browser.run(f"return {PLAYER}.webgl"), "WebGL2 in software")
    check(
        browser.run("return performance.getEntriesByType('resource').length") == 0,
        "nothing is loaded from elsewhere",
    )
    check(
        browser.run("return document.documentElement.scrollWidth <= window.innerWidth"),
        "no horizontal scrolling",
    )

    # 1. Both panes show something, and scrubbing changes it.
    page.focus()
    first = page.panes("light_first")
    for pane, name in zip(first, ("recorded", "predicted")):
        check(colours(pane) > 50, f"the {name} pane is not blank, {colours(pane)} colours")
    page.seek(90)
    error = page.panes("light_error")
    for before, after, name in zip(first, error, ("recorded", "predicted")):
        check(changed(before, after) > 0.02, f"scrubbing changes the {name} pane")
    check("90 / 120" in browser.run("return document.querySelector('.frame b').textContent"), "frame")
    check("45.0 ms" == browser.run("return document.querySelector('.time b').textContent"), "time")
    check("m" in browser.run("return document.querySelector('.rmse b').textContent"), "RMSE")

    # 2. Colours.
    page.key("2")
    det = page.panes("light_det")
    page.key("3")
    speed = page.panes("light_speed")
    page.key("1")
    check(changed(error[1], det[1]) > 0.1, "det F has colours of its own")
    check(changed(det[1], speed[1]) > 0.1, "speed has colours of its own")
    check(changed(det[0], speed[0]) > 0.1, "the recorded pane is coloured too")
    check(changed(error[1], page.panes()[1]) < 0.01, "1 brings the error back")

    # 3. Keys.
    page.key("\ue010")  # End
    check(page.state()["t"] == 120, "End goes to the last frame")
    page.key("\ue012")  # left
    stride = browser.run(f"return {PLAYER}.document.tracks[0].stride")
    check(page.state()["t"] == 120 - stride, "left goes back by a stored frame")
    page.key("\ue011")  # Home
    page.key("\ue014")  # right
    check(page.state()["t"] == stride, "right goes on by a stored frame")
    page.key("\ue014", shift=True)
    check(page.state()["t"] == 11 * stride, "with Shift by ten")
    page.key(" ")
    time.sleep(0.4)
    playing = page.state()
    page.key(" ")
    check(playing["playing"] and playing["t"] > 11 * stride, "space plays")
    paused = page.state()
    time.sleep(0.2)
    check(not paused["playing"] and page.state()["t"] == paused["t"], "space pauses")
    page.key("?")
    shown = "return !document.querySelector('.player-help').hidden"
    check(browser.run(shown), "? shows the keys")
    page.keep("light_help")
    page.key("?")
    check(not browser.run(shown), "? hides them")
    page.seek(90)
    page.key("e")
    check(changed(error[0], page.panes()[0]) > 0.02, "e takes the edges off")
    page.key("e")
    page.key("o")
    check(page.state()["overlay"], "o overlays")
    overlay = page.panes("light_overlay")
    check(changed(error[1], overlay[1]) > 0.05, "the overlay is another picture")
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
    check(
        browser.run("return document.documentElement.scrollWidth <= window.innerWidth"),
        "a phone needs no horizontal scrolling",
    )
    for pane in page.panes("phone", stacked=True, scale=2):
        check(colours(pane) > 50, "both panes on a phone")
    fits = browser.run(
        "return [...document.querySelectorAll('.player button, .player select, .player b')]"
        ".every(e => { const b = e.getBoundingClientRect();"
        " return b.left >= 0 && b.right <= window.innerWidth; })"
    )
    check(fits, "every control is inside a phone's window")
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


def check_messages(browser, what):
    for message in browser.messages():
        # Chromium says how slowly software draws; that is no fault of the page.
        if "GPU stall due to ReadPixels" in message["message"]:
            continue
        check(message["level"] not in ("SEVERE", "ERROR"), f"{what}: console: {message['message']}")


def check_speed(page):
    """Milliseconds of script per drawn frame of 10,000 vertices, and frames per second here."""
    page.window(1200, 900)
    page.focus()
    for pane in page.panes("large"):
        check(colours(pane) > 50, "the large body is drawn")
    script = page.browser.run(
        f"const p = {PLAYER}; p.render();"
        "p.stats.draws = p.stats.script_ms = 0;"
        "for (let i = 0; i < 20; ++i) { p.state.t = 1.37 * i; p.render(); }"
        "return p.stats.script_ms / p.stats.draws"
    )
    page.key("e")
    page.key(" ")
    page.browser.run(f"{PLAYER}.stats.draws = 0")
    time.sleep(1)
    frames = page.browser.run(f"return {PLAYER}.stats.draws")
    page.key(" ")
    page.seek(30)
    held = page.browser.run("return document.querySelector('.player-name.second small').textContent")
    check("diverged after frame 20" in held, "a held prediction is said to be so")
    upload = page.browser.run(f"return {PLAYER}.stats.upload_ms")
    print(
        f"10,000 vertices: {script:.2f} ms of script a frame, {upload:.0f} ms to load 40 frames; "
        f"{frames} frames a second in software"
    )
    check(script < 16, f"script takes {script:.1f} ms a frame")


def check_without_webgl(page):
    page.window(1200, 900)
    check(not page.browser.run(f"return {PLAYER}.webgl"), "no WebGL2 with --disable-3d-apis")
    said = page.browser.run("return document.querySelector('.player-message').textContent")
    check("no WebGL2" in said, "the player says what it lacks")
    page.keep("without_webgl")


def main():
    nmp, folder = sys.argv[1:]
    missing = find_programs()[2]
    if missing:
        print("skipped: missing " + ", ".join(missing) + " (Debian: chromium, chromium-driver)")
        return 77
    os.makedirs(folder, exist_ok=True)
    report = make_report(nmp, folder)
    large = make_large_page(report, folder)
    with Browser() as browser:
        check_page(Page(browser, report, folder))
        check_messages(browser, "report")
        check_speed(Page(browser, large, folder))
        check_messages(browser, "large page")
    with Browser(extra_flags=["--disable-3d-apis"]) as browser:
        check_without_webgl(Page(browser, report, folder))
        check_messages(browser, "without WebGL2")
    print(f"{len(failures)} failures; screenshots in {folder}")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
