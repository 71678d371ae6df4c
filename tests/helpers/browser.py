"""Chromium without a window, by its own protocol through a pipe: no package is needed."""

import json
import os
import shutil
import subprocess


def chromium():
    """Its path, or None."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Browser:
    """with Browser(folder for its profile) as browser: tab = browser.open(path of a page, width, scheme)"""

    def __init__(self, profile):
        read, self._to = os.pipe()
        self._from, write = os.pipe()
        words = [chromium(), "--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe"]
        shell = ["bash", "-c", f'exec "$@" 3<&{read} 4>&{write}', "bash", *words, f"--user-data-dir={profile}"]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self._process = subprocess.Popen(shell, pass_fds=(read, write), **quiet)
        os.close(read), os.close(write)
        self._number, self._rest, self.events = 0, b"", []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.kill()
        self._process.wait()
        os.close(self._to), os.close(self._from)

    def call(self, method, session=None, **params):
        """The answer; what the browser says meanwhile is kept in `events`."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": params} | ({"sessionId": session} if session else {})
        data = json.dumps(message).encode() + b"\0"
        while data:  # axe is half a megabyte, a pipe holds less
            data = data[os.write(self._to, data) :]
        while True:
            answer = self._message()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                return answer["result"]
            self.events.append(answer)

    def _message(self):
        while b"\0" not in self._rest:
            more = os.read(self._from, 1 << 20)
            assert more, "the browser ended"
            self._rest += more
        one, self._rest = self._rest.split(b"\0", 1)
        return json.loads(one)

    def open(self, path, width=1280, scheme="light"):
        """A tab that shows a file, whose scripts have run."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        tab = Tab(self, self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"])
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        tab.call("Emulation.setDeviceMetricsOverride", **size)
        tab.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        for domain in ("Page", "Runtime", "Log"):
            tab.call(f"{domain}.enable")
        tab.call("Page.setBypassCSP", enabled=True)
        tab.call("Page.navigate", url=path.resolve().as_uri())
        while tab.js("document.readyState") != "complete":
            pass
        return tab


class Tab:
    """One page in the browser."""

    def __init__(self, browser, session):
        self.browser, self.session = browser, session

    def call(self, method, **params):
        return self.browser.call(method, self.session, **params)

    def js(self, expression):
        """The value of JavaScript, awaited."""
        words = {"expression": expression, "awaitPromise": True, "returnByValue": True}
        answer = self.call("Runtime.evaluate", **words)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def key(self, name):
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=name, code=name)

    @property
    def complaints(self):
        """What the page wrote to the console as an error or a warning, and its exceptions."""
        mine = [e for e in self.browser.events if e.get("sessionId") == self.session]
        bad = [e["params"] for e in mine if e["method"] == "Runtime.exceptionThrown"]
        bad += [e["params"] for e in mine if e["method"] == "Log.entryAdded"]
        return bad + [
            e["params"]
            for e in mine
            if e["method"] == "Runtime.consoleAPICalled" and e["params"]["type"] in ("error", "warning")
        ]
