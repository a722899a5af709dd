"""A headless Chromium, driven through chromedriver's WebDriver protocol with the standard library.

Rendering is done in software (SwiftShader through ANGLE), so that WebGL2 works on any machine.
"""

import base64
import json
import os
import shutil
import socket
import struct
import subprocess
import tempfile
import time
import urllib.error
import urllib.request
import zlib

FLAGS = [
    "--headless=new",
    "--no-sandbox",  # Chromium refuses to run as root without it
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-first-run",
    "--no-default-browser-check",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-default-apps",
    "--disable-dev-shm-usage",
    "--disable-extensions",
    "--disable-quic",
    "--disable-sync",
    "--hide-scrollbars",
    "--force-device-scale-factor=1",
]


def find_programs():
    """Paths of Chromium and chromedriver, or what is missing."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    driver = shutil.which("chromedriver")
    missing = [name for name, path in (("chromium", chromium), ("chromedriver", driver)) if not path]
    return chromium, driver, missing


class Browser:
    """One browser window; a context manager."""

    def __init__(self, size=(1200, 900), extra_flags=()):
        chromium, driver, missing = find_programs()
        if missing:
            raise RuntimeError("missing: " + ", ".join(missing))
        self.profile = tempfile.mkdtemp(prefix="nmp_browser_")
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.url = f"http://127.0.0.1:{port}"
        self.log = open(os.path.join(self.profile, "chromedriver.log"), "wb")
        # Its own session, so that the browser ends with it.
        self.process = subprocess.Popen(
            [driver, f"--port={port}"], stdout=self.log, stderr=self.log, start_new_session=True
        )
        self.session = None
        try:
            self._wait_for_driver()
            options = {
                "binary": chromium,
                "args": FLAGS
                + [f"--window-size={size[0]},{size[1]}", f"--user-data-dir={self.profile}/user"]
                + list(extra_flags),
            }
            capabilities = {
                "browserName": "chrome",
                "goog:chromeOptions": options,
                "goog:loggingPrefs": {"browser": "ALL"},
            }
            answer = self._send(
                "POST", "/session", {"capabilities": {"alwaysMatch": capabilities}}, whole=True
            )
            self.session = answer["sessionId"]
        except BaseException:
            self.close()
            raise

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        if self.session:
            try:
                self._send("DELETE", "")
            except (OSError, RuntimeError):
                pass
        try:
            os.killpg(self.process.pid, 15)
            self.process.wait(timeout=10)
        except (ProcessLookupError, subprocess.TimeoutExpired):
            pass
        self.log.close()
        shutil.rmtree(self.profile, ignore_errors=True)

    def open(self, path):
        """A file; what stands after a # goes to the page."""
        path, mark, fragment = path.partition("#")
        self._send("POST", "/url", {"url": "about:blank"})  # the same file is loaded again
        self._send("POST", "/url", {"url": "file://" + os.path.realpath(path) + mark + fragment})

    def run(self, script, *arguments):
        """The value that `script`, the body of a function, returns."""
        return self._send("POST", "/execute/sync", {"script": script, "args": list(arguments)})

    def run_async(self, script, *arguments):
        """The value that `script` passes to its last argument, a callback."""
        return self._send("POST", "/execute/async", {"script": script, "args": list(arguments)})

    def key(self, text, shift=False):
        """Types into the element that has the focus."""
        steps = [{"type": "keyDown", "value": text}, {"type": "keyUp", "value": text}]
        if shift:
            steps = (
                [{"type": "keyDown", "value": "\ue008"}]
                + steps
                + [{"type": "keyUp", "value": "\ue008"}]
            )
        self._send("POST", "/actions", {"actions": [{"type": "key", "id": "keys", "actions": steps}]})

    def drag(self, start, by, steps=4):
        """Presses at a point of the window, moves, releases."""
        actions = [
            {"type": "pointerMove", "duration": 0, "x": start[0], "y": start[1]},
            {"type": "pointerDown", "button": 0},
        ]
        for k in range(1, steps + 1):
            x, y = (int(start[c] + by[c] * k / steps) for c in range(2))
            actions.append({"type": "pointerMove", "duration": 20, "x": x, "y": y})
        actions.append({"type": "pointerUp", "button": 0})
        pointer = {"type": "pointer", "id": "mouse", "actions": actions}
        self._send("POST", "/actions", {"actions": [pointer]})

    def wheel(self, at, dy):
        scroll = {"type": "scroll", "x": at[0], "y": at[1], "deltaX": 0, "deltaY": dy, "duration": 0}
        self._send("POST", "/actions", {"actions": [{"type": "wheel", "id": "w", "actions": [scroll]}]})

    def devtools(self, command, **parameters):
        body = {"cmd": command, "params": parameters}
        return self._send("POST", "/goog/cdp/execute", body)

    def screenshot(self):
        return base64.b64decode(self._send("GET", "/screenshot"))

    def messages(self):
        """What the console has said since the last call."""
        return self._send("POST", "/se/log", {"type": "browser"})

    def _wait_for_driver(self):
        for _ in range(200):
            try:
                if self._send("GET", "/status", top=True)["ready"]:
                    return
            except OSError:
                time.sleep(0.05)
        raise RuntimeError("chromedriver does not answer")

    def _send(self, method, path, body=None, whole=False, top=False):
        prefix = f"/session/{self.session}" if self.session and not top else ""
        request = urllib.request.Request(
            self.url + prefix + path,
            method=method,
            data=None if body is None else json.dumps(body).encode(),
            headers={"Content-Type": "application/json"},
        )
        # Never through a proxy: both ends are on this machine.
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        try:
            with opener.open(request, timeout=120) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            detail = json.load(error)["value"]
            raise RuntimeError(f"{path}: {detail['error']}: {detail['message']}") from None


class Picture:
    """Pixels of a PNG of 8 bits per channel without interlacing, as chromedriver makes them."""

    def __init__(self, png):
        position, data, self.width = 8, b"", 0
        while position < len(png):
            size, kind = struct.unpack(">I4s", png[position : position + 8])
            chunk = png[position + 8 : position + 8 + size]
            position += 12 + size
            if kind == b"IHDR":
                self.width, self.height, depth, colour, _, _, interlaced = struct.unpack(
                    ">IIBBBBB", chunk
                )
                if depth != 8 or colour not in (2, 6) or interlaced:
                    raise RuntimeError("a PNG of another kind")
                self.channels = 3 if colour == 2 else 4
            elif kind == b"IDAT":
                data += chunk
        raw, stride = zlib.decompress(data), self.width * self.channels
        self.rows, above = [], bytearray(stride)
        for y in range(self.height):
            start = y * (stride + 1)
            above = self._unfilter(raw[start], bytearray(raw[start + 1 : start + 1 + stride]), above)
            self.rows.append(above)

    def _unfilter(self, kind, row, above):
        n = self.channels
        if kind == 1:
            for i in range(n, len(row)):
                row[i] = row[i] + row[i - n] & 255
        elif kind == 2:
            for i in range(len(row)):
                row[i] = row[i] + above[i] & 255
        elif kind == 3:
            for i in range(len(row)):
                row[i] = row[i] + ((row[i - n] if i >= n else 0) + above[i] >> 1) & 255
        elif kind == 4:
            for i in range(len(row)):
                a, b = row[i - n] if i >= n else 0, above[i]
                c = above[i - n] if i >= n else 0
                pa, pb, pc = abs(b - c), abs(a - c), abs(a + b - 2 * c)
                nearest = a if pa <= pb and pa <= pc else b if pb <= pc else c
                row[i] = row[i] + nearest & 255
        return row

    def pixels(self, left, top, right, bottom):
        """RGB of a rectangle, row by row."""
        n = self.channels
        for y in range(max(0, int(top)), min(self.height, int(bottom))):
            row = self.rows[y]
            for x in range(max(0, int(left)), min(self.width, int(right))):
                yield row[n * x], row[n * x + 1], row[n * x + 2]
