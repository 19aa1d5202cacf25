"""A headless Chromium over its debugging protocol, for tests of the pages."""

import base64
import itertools
import json
import shutil
import subprocess
import tempfile
import time
import urllib.request
from contextlib import ExitStack
from pathlib import Path

from websockets.sync.client import connect

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


class Browser:
    """One page in a browser process of its own; a context manager.

    Attributes:
        events: what the page asked of the network and said to the console, in order.
    """

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self.events: list[dict] = []

    def __enter__(self):
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True)))
            process = subprocess.Popen(
                [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
                 "--disable-background-networking", "--disable-component-update", "--disable-sync", "--remote-debugging-port=0",
                 "--remote-allow-origins=*", f"--user-data-dir={folder}", "about:blank"],
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip
            stack.callback(process.wait)
            stack.callback(process.kill)
            page = next(target for target in self._targets(folder) if target["type"] == "page")
            self._socket = stack.enter_context(connect(page["webSocketDebuggerUrl"], max_size=None))
            for domain in ("Page", "Network", "Log", "Runtime"):
                self.call(f"{domain}.enable")
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_):
        self._stack.close()

    @staticmethod
    def _targets(folder: Path) -> list[dict]:
        port_file = folder / "DevToolsActivePort"
        deadline = time.monotonic() + 60
        while not (port_file.exists() and port_file.read_text().strip()) and time.monotonic() < deadline:
            time.sleep(0.1)
        port = port_file.read_text().split()[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
            return json.load(answer)

    def call(self, method: str, **params):
        """One command of the protocol, and its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            message = json.loads(self._socket.recv(timeout=60))
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]
            self.events.append(message)

    def open(self, path: Path, width: int = 1000, height: int = 900, dark: bool = False) -> None:
        """Load a file at some window size."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", media="screen", features=[scheme])
        self.events.clear()
        self.call("Page.navigate", url=path.absolute().as_uri())
        deadline = time.monotonic() + 60
        while self.evaluate("document.readyState") != "complete" and time.monotonic() < deadline:
            time.sleep(0.05)

    def evaluate(self, expression: str):
        """The value of a JavaScript expression in the page."""
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def requests(self) -> list[str]:
        """What the page asked for, without what is in it."""
        sent = [
            e["params"]["request"]["url"] for e in self.events if e["method"] == "Network.requestWillBeSent"
        ]
        return [url for url in sent if not url.startswith("data:")]

    def complaints(self) -> list[str]:
        """What the browser said was wrong with the page."""
        return [
            e["params"].get("entry", {}).get("text") or json.dumps(e["params"])
            for e in self.events
            if e["method"] in ("Log.entryAdded", "Runtime.exceptionThrown")
        ]

    def key(self, key: str) -> None:
        """Press a key."""
        codes = {"Enter": (13, "\r"), "Tab": (9, ""), "Escape": (27, "")}
        code, text = codes.get(key, (0, key if len(key) == 1 else ""))
        more = {"text": text} if text else {}
        for kind in ("keyDown", "keyUp"):
            sent = more if kind == "keyDown" else {}
            self.call(
                "Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code, **sent
            )

    def scripts(self, on: bool) -> None:
        """Let pages run scripts, or not, from the next `open` on."""
        self.call("Emulation.setScriptExecutionDisabled", value=not on)

    def text(self) -> str:
        """The text that a page shows, also without scripts."""
        root = self.call("DOM.getDocument", depth=0)["root"]["nodeId"]
        body = self.call("DOM.querySelector", nodeId=root, selector="main")["nodeId"]
        node = self.call("DOM.resolveNode", nodeId=body)["object"]["objectId"]
        said = self.call(
            "Runtime.callFunctionOn",
            objectId=node,
            functionDeclaration="function() { return this.innerText }",
        )
        return said["result"]["value"]

    def pdf(self) -> bytes:
        """The page as it is printed."""
        self.call("Emulation.setEmulatedMedia", media="")
        return base64.b64decode(
            self.call("Page.printToPDF", printBackground=False, preferCSSPageSize=True)["data"]
        )
