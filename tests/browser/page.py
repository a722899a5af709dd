"""A page with a player, and what checks of it share."""

import os
import subprocess
import sys

from browser import Browser, Picture, find_programs

TINY = """mesh.vertices_per_edge=5 time.frames=120 time.dt=1e-4 time.substeps=5
    initial.clearance=0.02 dataset.train=2 dataset.validation=2""".split()

PLAYER = "document.querySelector('[data-player]').nmpPlayer"
failures = []


def check(truth, what):
    if not truth:
        failures.append(what)
        print("FAILED: " + what, flush=True)


class Program:
    """nmp, working in a folder; its messages go to a file there."""

    def __init__(self, nmp, folder):
        self.nmp, self.folder = nmp, folder
        os.makedirs(folder, exist_ok=True)
        self.log = open(os.path.join(folder, "nmp.log"), "w", encoding="utf-8")

    def path(self, name):
        return os.path.join(self.folder, name)

    def run(self, *arguments):
        command = [self.nmp] + list(arguments)
        result = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=self.log)
        if result.returncode != 0:
            sys.exit(f"nmp {' '.join(arguments)} failed; see {self.log.name}")

    def generate(self, name, keys):
        """A dataset of the scene cube, with settings."""
        settings = [part for key in keys for part in ("--set", key)]
        self.run("data", "gen", "cube", "-o", self.path(name), "--force", *settings)
        return self.path(name)


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

    def panes(self, name=None, scale=1):
        """Middles of the panes as lists of pixels."""
        picture = Picture(self.keep(name) if name else self.browser.screenshot())
        boxes = self.browser.run(
            "return [...document.querySelectorAll('.player-pane')].map(e => {"
            " const b = e.getBoundingClientRect(); return [b.left, b.top, b.width, b.height]; })"
        )
        panes = []
        for box in boxes:
            x, y, w, h = (scale * v for v in box)
            panes.append(list(picture.pixels(x + w * 0.2, y + h * 0.2, x + w * 0.8, y + h * 0.9)))
        return panes

    def frame(self):
        """The number of the frame that is shown."""
        return int(self.text(".frame b")[0].split(" / ")[0])

    def text(self, selector):
        return self.browser.run(
            "return [...document.querySelectorAll(arguments[0])].map(e => e.textContent)", selector
        )

    def fits(self):
        """Nothing needs horizontal scrolling, no control is outside of the window."""
        return self.browser.run(
            "return document.documentElement.scrollWidth <= window.innerWidth &&"
            " [...document.querySelectorAll('.player button, .player select, .player b')]"
            ".every(e => { const b = e.getBoundingClientRect();"
            " return b.left >= 0 && b.right <= window.innerWidth; })"
        )


def colours(pane):
    return len(set(pane))


def changed(a, b):
    """Part of the pixels that differ visibly."""
    return sum(sum(abs(p - q) for p, q in zip(x, y)) > 24 for x, y in zip(a, b)) / max(1, len(a))


def check_messages(browser, what):
    for message in browser.messages():
        # Chromium says how slowly software draws; that is no fault of the page.
        if "GPU stall due to ReadPixels" in message["message"]:
            continue
        check(message["level"] not in ("SEVERE", "ERROR"), f"{what}: console: {message['message']}")


def main(checks):
    """Runs checks(program, folder) with the arguments of the command line."""
    nmp, folder = sys.argv[1:]
    missing = find_programs()[2]
    if missing:
        print("skipped: missing " + ", ".join(missing) + " (Debian: chromium, chromium-driver)")
        return 77
    checks(Program(nmp, folder), folder)
    print(f"{len(failures)} failures; screenshots in {folder}")
    return 1 if failures else 0
