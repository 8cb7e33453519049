"""Records what the page of `vobc run --watch` shows, as a moving picture.

`python -m metro_tools.page_recording RUN -o watch.webp` lets the logs of a finished run grow again
in steps, serves them with `vobc watch`, and takes a picture of the page in headless Chromium after
each step. The last picture is the report. The same logs give the same pictures with one browser
and one set of fonts.
"""

import argparse
import json
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from PIL import Image

from firmware_py.assertions import require_assertions
from metro_tools.browser import Browser, BrowserError, browser_path

WIDTH_PX: Final = 1200
HEIGHT_PX: Final = 860
SHOWN_PX: Final = (900, 645)
"""Size of the picture."""
STEP_S: Final = 1.0
"""Time of the run between two pictures."""
FROM_S: Final = 4.0
"""The picture begins here. Before, the controller waits for its inputs."""
SPEED_UP: Final = 8.0
"""How many seconds of the run pass in one of the picture."""
LAST_S: Final = 3.0
"""How long the report stays before the first picture comes again."""
MS_PER_S: Final = 1000.0
QUALITY: Final = 45
READY: Final = "document.documentElement.dataset.ready"
EXIT_OK: Final = 0
EXIT_USAGE: Final = 2
EXIT_ENVIRONMENT: Final = 3


def main(argv: Sequence[str] | None = None) -> int:
    """Write the picture; exit code 2 for a run that cannot be read, 3 without a browser."""
    require_assertions("page_recording")
    parser = argparse.ArgumentParser(
        prog="python -m metro_tools.page_recording", description=__doc__
    )
    parser.add_argument("run", type=Path, help="folder of a run in virtual time that has ended")
    parser.add_argument("-o", dest="out", type=Path, default=Path("watch.webp"), metavar="FILE")
    options = parser.parse_args(argv)
    if browser_path() is None:
        print("page_recording: it needs Chromium, which is not installed", file=sys.stderr)
        return EXIT_ENVIRONMENT
    try:
        save(list(pictures(options.run)), options.out)
    except OSError as error:
        print(f"page_recording: {error}", file=sys.stderr)
        return EXIT_USAGE
    except BrowserError as error:
        print(f"page_recording: the page does not follow the run: {error}", file=sys.stderr)
        return EXIT_ENVIRONMENT
    return EXIT_OK


def pictures(run: Path) -> Iterator[Image.Image]:
    """Yield the pictures of the page. Raises OSError for a file that a run should have."""
    with tempfile.TemporaryDirectory() as scratch:
        # The folder's name is the title of the page.
        grown = Path(scratch) / "florence_II-III"
        grown.mkdir()
        shutil.copy(run / "run.toml", grown)
        steps = growing(run, grown)
        next(steps)
        with served(grown) as address, Browser(width=WIDTH_PX, height=HEIGHT_PX) as browser:
            browser.open(address)
            for frames in steps:
                browser.wait(f"Number(document.documentElement.dataset.drawn) === {frames}")
                yield _picture(browser, Path(scratch))
            shutil.copy(run / "results.json", grown)
            report = f"canlog.view.head.live === undefined && {READY}"
            with suppress(BrowserError):
                # The page loads itself again while the browser evaluates this.
                browser.wait(report)
            browser.wait(report)
            yield _picture(browser, Path(scratch))


def growing(run: Path, grown: Path) -> Iterator[int]:
    """Let frames and events of a run grow in another folder; yield the number of frames so far."""
    frames = (run / "bus.log").read_text(encoding="ascii").splitlines(keepends=True)
    events = (run / "events.jsonl").read_text(encoding="utf-8").splitlines(keepends=True)
    written, at_s = 0, FROM_S
    with (
        (grown / "bus.log").open("w", encoding="ascii", buffering=1) as log,
        (grown / "events.jsonl").open("w", encoding="utf-8", buffering=1) as story,
    ):
        while frames:
            now = [line for line in frames if frame_s(line) < at_s]
            happened = [line for line in events if json.loads(line)["t_s"] < at_s]
            story.write("".join(happened))
            log.write("".join(now))
            frames, events = frames[len(now) :], events[len(happened) :]
            written += len(now)
            story.flush()
            log.flush()
            yield written
            at_s += STEP_S


def frame_s(line: str) -> float:
    """Return the instant of a line of candump, `(seconds) bus frame`."""
    return float(line[1 : line.index(")")])


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """Serve the page of a run with `vobc watch`, and yield its address."""
    program = Path(sys.executable).with_name("vobc")
    process = subprocess.Popen(  # noqa: S603
        [program, "watch", folder, "--no-browser"], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    try:
        yield process.stdout.readline().split()[1]
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()
        process.stdout.close()


def _picture(browser: Browser, scratch: Path) -> Image.Image:
    browser.settle()
    path = scratch / "picture.png"
    browser.screenshot(path)
    with Image.open(path) as picture:
        return picture.convert("RGB").resize(SHOWN_PX, Image.Resampling.LANCZOS)


def save(images: Sequence[Image.Image], path: Path) -> None:
    """Write an animated WebP that repeats for ever."""
    durations = [round(MS_PER_S * STEP_S / SPEED_UP)] * (len(images) - 1)
    images[0].save(
        path,
        save_all=True,
        append_images=images[1:],
        duration=[*durations, round(MS_PER_S * LAST_S)],
        loop=0,
        quality=QUALITY,
        method=4,
    )


if __name__ == "__main__":
    sys.exit(main())
