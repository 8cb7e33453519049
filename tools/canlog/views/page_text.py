"""Builds the page of a log as one text, with its style, scripts and data."""

import html
from importlib import resources
from typing import Final

from canlog.views.page_data import PageData

SCRIPTS: Final = (
    "decode.js",
    "trace.js",
    "source.js",
    "remote.js",
    "view.js",
    "plots.js",
    "steer.js",
    "journey.js",
    "table.js",
    "lists.js",
    "picker.js",
    "app.js",
)
"""Scripts in the order in which they stand in the page; they share one scope."""


def page_text(data: PageData) -> str:
    """Return HTML that needs no other file, only its server if the frames are not included."""
    script = "\n".join(part(name) for name in SCRIPTS)
    parts = {
        "title": html.escape(str(data.head["title"])),
        "style": part("style.css"),
        "head": data.head_text(),
        "block": "" if data.head["remote"] else data.block.text(),
        "script": f'(() => {{\n"use strict";\n{script}\n}})();',
    }
    pieces = part("index.html").split("{{")
    filled = [pieces[0]]
    for piece in pieces[1:]:
        name, _, rest = piece.partition("}}")
        filled += (parts[name], rest)
    return "".join(filled)


def part(name: str) -> str:
    return (resources.files("canlog.views") / "page" / name).read_text("utf-8")
