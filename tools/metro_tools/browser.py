"""A headless Chromium for tests and benchmarks: pages, keys, pointer, screenshots."""

import base64
import json
import os
import shutil
import subprocess
import tempfile
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Final

NAMES: Final = ("chromium", "chromium-browser", "google-chrome", "chrome")
END: Final = b"\0"
PATIENCE_S: Final = 60
FLAGS: Final = (
    "--headless=new",
    "--remote-debugging-pipe",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-extensions",
    "--disable-background-networking",
    "--disable-component-update",
    "--hide-scrollbars",
    "--force-color-profile=srgb",
    "about:blank",
)


def browser_path() -> str | None:
    """Return the path of the first browser found; None if none is installed."""
    return next((found for name in NAMES if (found := shutil.which(name))), None)


class BrowserError(Exception):
    """The browser refused a call or did not answer."""


class Browser:
    """One page in a browser.

    It uses DevTools over two pipes, so it needs no port and no library.
    """

    def __init__(self, *, width: int = 1440, height: int = 900) -> None:
        path = browser_path()
        assert path is not None
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        to_read, self._to = os.pipe()
        self._from, from_write = os.pipe()

        def ends() -> None:
            # DevTools reads from descriptor 3 and writes to 4; neither may be overwritten before it
            # is set.
            low, high = os.dup(to_read), os.dup(from_write)
            high_low, high_high = os.dup2(low, 60), os.dup2(high, 61)
            os.dup2(high_low, 3)
            os.dup2(high_high, 4)

        words = [path, f"--user-data-dir={self._profile.name}", f"--window-size={width},{height}"]
        self._process = subprocess.Popen(  # noqa: S603
            [*words, *FLAGS],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            preexec_fn=ends,
            pass_fds=(3, 4),
        )
        os.close(to_read)
        os.close(from_write)
        self._rest = b""
        self._number = 0
        self._session: str | None = None
        self.log: list[str] = []
        """Errors and messages of the page's console."""
        self.asked: list[str] = []
        """Addresses that the page fetched."""
        self._events: list[dict[str, Any]] = []
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(each["targetId"] for each in targets if each["type"] == "page")
        attached = self.call("Target.attachToTarget", targetId=page, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Network"):
            self.call(f"{domain}.enable")
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    def __enter__(self) -> "Browser":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._to)
        os.close(self._from)
        self._profile.cleanup()

    def call(self, method: str, **parameters: Any) -> Any:
        """Call a DevTools method and return its result. Raises BrowserError."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        text = json.dumps(message).encode() + END
        while text:
            text = text[os.write(self._to, text) :]
        while True:
            got = self._next()
            if got.get("id") == self._number:
                if "error" in got:
                    raise BrowserError(f"{method}: {got['error']['message']}")
                return got["result"]

    def _next(self) -> dict[str, Any]:
        while END not in self._rest:
            piece = os.read(self._from, 1 << 16)
            if not piece:
                raise BrowserError("the browser ended")
            self._rest += piece
        text, _, self._rest = self._rest.partition(END)
        got: dict[str, Any] = json.loads(text)
        self._notice(got)
        return got

    def _notice(self, got: dict[str, Any]) -> None:
        method, told = got.get("method"), got.get("params", {})
        if method == "Runtime.exceptionThrown":
            details = told["exceptionDetails"]
            self.log.append(details.get("exception", {}).get("description", details["text"]))
        elif method == "Runtime.consoleAPICalled":
            self.log.append(" ".join(str(each.get("value")) for each in told["args"]))
        elif method == "Network.requestWillBeSent":
            self.asked.append(told["request"]["url"])

    def open(self, address: str, ready: str = "document.documentElement.dataset.ready") -> None:
        """Load a page and wait until the expression `ready` is true in it."""
        self.call("Page.navigate", url=address)
        self.wait(ready)

    def run(self, script: str) -> Any:
        """Evaluate an expression in the page, wait for promises, and return its value.

        Raises BrowserError.
        """
        got = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in got:
            raise BrowserError(f"{script}: {got['exceptionDetails']}")
        return got["result"].get("value")

    def wait(self, script: str) -> Any:
        """Poll an expression until it is true, and return its value. Raises BrowserError."""
        return self.run(
            f"""new Promise((done, failed) => {{
              const end = performance.now() + {PATIENCE_S * 1000};
              const look = () => {{
                let value = null;
                try {{ value = {script}; }} catch (error) {{ value = null; }}
                if (value) done(value);
                else if (performance.now() > end) failed(new Error("never true"));
                else setTimeout(look, 15);
              }};
              look();
            }})"""
        )

    def settle(self) -> None:
        """Wait until the page has drawn all pending changes."""
        self.run("new Promise(done => requestAnimationFrame(() => setTimeout(done, 30)))")

    def key(self, key: str, *, shift: bool = False) -> None:
        named = len(key) > 1
        pressed: dict[str, Any] = {"key": key, "modifiers": 8 if shift else 0}
        if not named:
            pressed["text"] = key
        if key == "Enter":
            pressed |= {"text": "\r", "windowsVirtualKeyCode": 13}
        self.call("Input.dispatchKeyEvent", type="keyDown", **pressed)
        self.call("Input.dispatchKeyEvent", type="keyUp", **pressed)
        self.settle()

    def type(self, text: str) -> None:
        self.call("Input.insertText", text=text)
        self.settle()

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def click(self, x: float, y: float) -> None:
        self.drag([(x, y)])

    def drag(self, points: list[tuple[float, float]], *, shift: bool = False) -> None:
        """Press at the first point, move along the others, and release at the last."""
        more: dict[str, Any] = {"button": "left", "modifiers": 8 if shift else 0}
        self.mouse("mouseMoved", *points[0])
        self.mouse("mousePressed", *points[0], clickCount=1, buttons=1, **more)
        for x, y in points[1:]:
            self.mouse("mouseMoved", x, y, buttons=1, **more)
        self.mouse("mouseReleased", *points[-1], clickCount=1, **more)
        self.settle()

    def wheel(self, x: float, y: float, turned: float) -> None:
        self.mouse("mouseWheel", x, y, deltaX=0, deltaY=turned)
        self.settle()

    def box(self, selector: str) -> tuple[float, float, float, float]:
        """Return left, top, width and height of an element."""
        got = self.run(
            f"(b => [b.left, b.top, b.width, b.height])"
            f"(document.querySelector({json.dumps(selector)}).getBoundingClientRect())"
        )
        return got[0], got[1], got[2], got[3]

    def text(self, selector: str) -> str:
        return str(self.run(f"document.querySelector({json.dumps(selector)}).innerText"))

    def memory_mb(self) -> float:
        """Return the resident memory of all processes of the browser in megabytes."""
        parents = {}
        for path in Path("/proc").glob("[0-9]*/stat"):
            with suppress(OSError):
                parents[int(path.parent.name)] = int(path.read_text().rpartition(")")[2].split()[1])
        found, pages = [self._process.pid], 0
        for pid in found:
            found += [child for child, parent in parents.items() if parent == pid]
            with suppress(OSError):
                pages += int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6

    def screenshot(self, path: Path) -> None:
        got = self.call("Page.captureScreenshot", format="png")
        path.write_bytes(base64.b64decode(got["data"]))
