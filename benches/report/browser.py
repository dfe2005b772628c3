"""Chromium without a window, driven over pipes by the DevTools protocol. Needs nothing but Python and Chromium."""

import base64
import json
import os
import select
import shutil
import struct
import subprocess
import tempfile
import time
import zlib


def find():
    """Returns the path of Chromium, or None."""
    return next(filter(None, map(shutil.which, ["chromium", "chromium-browser", "google-chrome"])), None)


class Browser:
    """A page of Chromium. `errors` holds every error of its console and every exception."""

    def __init__(self, size=(1280, 900), arguments=()):
        self.folder = tempfile.mkdtemp(prefix="report-browser-")
        (from_us, self.to_browser), (self.from_browser, to_us) = os.pipe(), os.pipe()
        # The browser reads from descriptor 3 and writes to 4.
        command = [
            "bash", "-c", f'exec "$@" 3<&{from_us} 4>&{to_us}', "browser",
            find(), "--headless", "--remote-debugging-pipe", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
            "--disable-background-networking", "--no-first-run", "--force-color-profile=srgb", "--mute-audio",
            # WebGL without a graphics card, which Chromium otherwise warns about.
            "--enable-unsafe-swiftshader",
            f"--user-data-dir={self.folder}", f"--window-size={size[0]},{size[1]}", *arguments, "about:blank",
        ]
        with open(os.path.join(self.folder, "log"), "wb") as log:
            self.process = subprocess.Popen(
                command, pass_fds=[from_us, to_us], stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        os.close(from_us)
        os.close(to_us)
        self.number, self.rest, self.errors, self.events, self.session = 0, b"", [], [], None
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ["Page", "Runtime", "Log"]:
            self.send(f"{domain}.enable")
        self.resize(size)

    def _receive(self, deadline):
        while b"\0" not in self.rest:
            if not select.select([self.from_browser], [], [], max(0, deadline - time.monotonic()))[0]:
                raise TimeoutError("Chromium does not answer")
            data = os.read(self.from_browser, 1 << 20)
            if not data:
                raise EOFError("Chromium has ended: " + open(os.path.join(self.folder, "log")).read()[-2000:])
            self.rest += data
        message, self.rest = self.rest.split(b"\0", 1)
        message = json.loads(message)
        method, values = message.get("method"), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            details = values["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description") or details["text"])
        elif method == "Runtime.consoleAPICalled" and values["type"] in ("error", "assert"):
            self.errors.append(" ".join(str(part.get("value")) for part in values["args"]))
        elif method == "Log.entryAdded" and values["entry"]["level"] == "error":
            self.errors.append(values["entry"]["text"])
        if method:
            self.events.append(method)
        return message

    def send(self, method, timeout=60, **params):
        """Calls a method of the protocol and returns its result."""
        self.number += 1
        message = {"id": self.number, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.to_browser, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + timeout
        while True:
            answer = self._receive(deadline)
            if answer.get("id") == self.number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]

    def open(self, path, part=""):
        """Opens a file and returns the seconds until its page is shown."""
        self.events.clear()
        begun = time.monotonic()
        self.send("Page.navigate", url="file://" + os.path.abspath(path) + part)
        while "Page.loadEventFired" not in self.events:
            self._receive(begun + 60)
        # Two frames later the page is on the screen.
        self.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")
        return time.monotonic() - begun

    def run(self, script):
        """Evaluates JavaScript and returns its value; a promise is awaited."""
        answer = self.send("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(answer["exceptionDetails"]["exception"].get("description", "exception"))
        return answer["result"].get("value")

    def frames(self, count=2):
        """Waits until the page was painted so often."""
        self.run(f"new Promise(done => {{ let n = {count}; const step = () => n-- ? requestAnimationFrame(step) : done(1); step(); }})")

    def mouse(self, kind, x, y, buttons=0):
        button = "left" if kind != "mouseMoved" or buttons else "none"
        self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=buttons, clickCount=1)

    def drag(self, start, end, steps=8):
        """Drags with the left button."""
        self.mouse("mousePressed", *start, buttons=1)
        for k in range(1, steps + 1):
            place = [a + (b - a) * k / steps for a, b in zip(start, end)]
            self.mouse("mouseMoved", *place, buttons=1)
        self.mouse("mouseReleased", *end)
        self.frames()

    def resize(self, size, ratio=1, phone=False):
        self.send("Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=ratio, mobile=phone)

    def theme(self, name):
        """Shows the page in "light" or "dark"."""
        self.send("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": name}])

    def picture(self, whole=False, clip=None):
        """Returns the window, the whole page, or a part (x, y, width, height of the page) as PNG."""
        options = {"format": "png", "captureBeyondViewport": whole or clip is not None}
        if clip:
            options["clip"] = dict(zip(["x", "y", "width", "height"], clip), scale=1)
        return base64.b64decode(self.send("Page.captureScreenshot", **options)["data"])

    def close(self):
        try:
            self.session = None
            self.send("Browser.close", timeout=10)
        except (OSError, EOFError, TimeoutError):
            pass
        try:
            self.process.wait(10)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)


def pixels(png):
    """Decodes an 8-bit PNG without interlacing: width, height and rows of (red, green, blue)."""
    assert png.startswith(b"\x89PNG\r\n\x1a\n")
    at, data, head = 8, b"", None
    while at < len(png):
        length, kind = struct.unpack(">I4s", png[at : at + 8])
        body = png[at + 8 : at + 8 + length]
        head = struct.unpack(">IIBBBBB", body) if kind == b"IHDR" else head
        data += body if kind == b"IDAT" else b""
        at += length + 12
    width, height, depth, colour, _, _, interlaced = head
    assert depth == 8 and colour in (2, 6) and not interlaced
    size = 3 if colour == 2 else 4
    raw, stride, before, rows = zlib.decompress(data), width * size, bytearray(width * size), []
    for y in range(height):
        start = y * (stride + 1)
        kind, line = raw[start], bytearray(raw[start + 1 : start + 1 + stride])
        for x in range(stride):
            left = line[x - size] if x >= size else 0
            up, corner = before[x], before[x - size] if x >= size else 0
            if kind == 1:
                line[x] = line[x] + left & 255
            elif kind == 2:
                line[x] = line[x] + up & 255
            elif kind == 3:
                line[x] = line[x] + (left + up) // 2 & 255
            elif kind == 4:
                guess = left + up - corner
                near = min((abs(guess - left), 0, left), (abs(guess - up), 1, up), (abs(guess - corner), 2, corner))
                line[x] = line[x] + near[2] & 255
        rows.append([tuple(line[x : x + 3]) for x in range(0, stride, size)])
        before = line
    return width, height, rows
