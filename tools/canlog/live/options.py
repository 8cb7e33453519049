"""Options of the commands that serve the live page."""

import argparse
import os
import sys
from typing import Final

from canlog.views.serving import LOOPBACK

DISPLAYS: Final = ("DISPLAY", "WAYLAND_DISPLAY")


def add_serving(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--port", type=int, default=0, help="default: a free one")
    parser.add_argument(
        "--listen",
        metavar="ADDRESS",
        default=LOOPBACK,
        help="address of this machine for viewers on other machines, such as 0.0.0.0; default: "
        "%(default)s, this machine only",
    )
    parser.add_argument("--no-browser", action="store_true", help="only print the address")


def can_show() -> bool:
    """Whether this machine has a desktop that can show a browser."""
    return sys.platform == "darwin" or any(os.environ.get(name) for name in DISPLAYS)


def warn_of(listen: str, program: str) -> None:
    """Warn on standard error if other machines can reach the page."""
    if listen == LOOPBACK:
        return
    print(
        f"{program}: warning: --listen {listen}: other machines can read this page, without"
        " encryption, if they know its address",
        file=sys.stderr,
    )
