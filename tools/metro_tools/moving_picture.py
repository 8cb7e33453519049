"""Makes a moving picture of what `vobc run` shows on a terminal, from the frames of a run.

`python -m metro_tools.moving_picture RUN -o live.gif` replays the run's bus log into the live
display. The same log gives the same bytes, so `make docs` makes the picture again only when the
run has changed.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Final

import matplotlib
from PIL import Image, ImageDraw, ImageFont
from rich.color import Color
from rich.console import Console, RenderableType
from rich.segment import Segment
from rich.style import Style
from rich.terminal_theme import MONOKAI

from canlog import LogError, read
from firmware_py.ports import CanFrame
from metro_hil.realtime.live_display import BusPicture, render

BIT_RATE: Final = 250_000
COLUMNS: Final = 84
ROWS: Final = 12
FONT_PX: Final = 14
CELL_PX: Final = (8, 18)
MARGIN_PX: Final = 10
SHADES: Final = 6
"""Palette entries for each colour, from the background to the colour: the soft edges of letters."""
FRAME_S: Final = 0.5
"""Time of the run between two pictures."""
FROM_S: Final = 5.0
"""The picture begins here. Before, the controller waits for its inputs."""
SPEED_UP: Final = 4.0
"""How many seconds of the run pass in one of the picture."""
LAST_S: Final = 3.0
"""How long the last picture stays before the first comes again."""
Rgb = tuple[int, int, int]
NS_PER_S: Final = 1_000_000_000
BACKGROUND: Final = (24, 26, 31)
FOREGROUND: Final = (214, 216, 220)


def main(argv: Sequence[str] | None = None) -> int:
    """Write the picture; exit code 2 for a run that cannot be read."""
    parser = argparse.ArgumentParser(
        prog="python -m metro_tools.moving_picture", description=__doc__
    )
    parser.add_argument("run", type=Path, help="a run folder with bus.log")
    parser.add_argument("-o", dest="out", type=Path, default=Path("live.gif"), metavar="FILE")
    parser.add_argument("--title", default="florence II → III", help="first line of the display")
    options = parser.parse_args(argv)
    terminal = Terminal()
    try:
        pictures = [
            terminal.drawn(render(picture, now_ns, elapsed_s, options.title))
            for picture, now_ns, elapsed_s in moments(options.run / "bus.log")
        ]
        save(pictures, terminal.palette(), options.out)
    except (OSError, LogError) as error:
        print(f"moving_picture: {error}", file=sys.stderr)
        return 2
    return 0


def moments(log: Path) -> Iterator[tuple[BusPicture, int, float]]:
    """The display's state at each picture, its instant, and the time since the first frame."""
    frames = read(log).frames
    picture = BusPicture(BIT_RATE)
    start_ns = int(frames.at_ns[0])
    due_ns = start_ns
    picture.close_window(start_ns)
    for row in range(len(frames)):
        at_ns = int(frames.at_ns[row])
        while at_ns >= due_ns:
            if (due_ns - start_ns) % NS_PER_S == 0:
                picture.close_window(due_ns)
            if due_ns - start_ns >= FROM_S * NS_PER_S:
                yield picture, due_ns, (due_ns - start_ns) / NS_PER_S
            due_ns += round(FRAME_S * NS_PER_S)
        picture.take(CanFrame(at_ns, int(frames.identifier[row]), frames.payload(row)))


class Terminal:
    """Draws what rich prints, letter by letter, and remembers the colours that it used."""

    def __init__(self) -> None:
        self._console = Console(width=COLUMNS, force_terminal=True, color_system="truecolor")
        self._used: set[Rgb] = set()

    def drawn(self, panel: RenderableType) -> Image.Image:
        """One picture of the terminal."""
        lines = self._console.render_lines(panel, pad=False)
        width, height = CELL_PX
        size = (COLUMNS * width + 2 * MARGIN_PX, ROWS * height + 2 * MARGIN_PX)
        image = Image.new("RGB", size, BACKGROUND)
        pen = ImageDraw.Draw(image)
        for number, line in enumerate(lines[:ROWS]):
            self._draw_line(pen, line, MARGIN_PX + number * height)
        return image

    def palette(self) -> Image.Image:
        """Every used colour in shades towards the background, for the soft edges of letters."""
        parts = [
            round(behind + (part - behind) * shade / SHADES)
            for colour in sorted(self._used)
            for shade in range(1, SHADES + 1)
            for part, behind in zip(colour, BACKGROUND, strict=True)
        ]
        image = Image.new("P", (1, 1))
        image.putpalette([*BACKGROUND, *parts])
        return image

    def _draw_line(self, pen: ImageDraw.ImageDraw, line: Sequence[Segment], top: int) -> None:
        width, height = CELL_PX
        left = MARGIN_PX
        for text, style, _ in line:
            style = style or Style.null()
            if style.bgcolor:
                box = (left, top, left + len(text) * width, top + height)
                pen.rectangle(box, fill=self._rgb(style.bgcolor))
            ink = self._rgb(style.color, dim=bool(style.dim))
            # Each letter stands in its own cell, as on a terminal.
            for letter in text:
                if letter != " ":
                    pen.text((left, top + 1), letter, ink, _font(bool(style.bold)))
                left += width

    def _rgb(self, colour: Color | None, *, dim: bool = False) -> Rgb:
        rgb = FOREGROUND if colour is None else tuple(colour.get_truecolor(MONOKAI))
        if dim:
            rgb = tuple((part + behind) // 2 for part, behind in zip(rgb, BACKGROUND, strict=True))
        red, green, blue = rgb
        self._used.add((red, green, blue))
        return red, green, blue


@cache
def _font(bold: bool) -> ImageFont.FreeTypeFont:
    name = f"DejaVuSansMono{'-Bold' if bold else ''}.ttf"
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name, FONT_PX)


def save(pictures: Sequence[Image.Image], palette: Image.Image, path: Path) -> None:
    """As an animated GIF that repeats for ever, with one palette for all pictures."""
    frames = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures]
    still_ms = round(FRAME_S / SPEED_UP * 1000.0)
    durations = [still_ms] * (len(frames) - 1) + [round(LAST_S * 1000.0)]
    frames[0].save(
        path, save_all=True, append_images=frames[1:], duration=durations, loop=0, optimize=True
    )


if __name__ == "__main__":
    sys.exit(main())
