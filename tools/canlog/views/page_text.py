"""The page of a log as one text: markup with its style, scripts and data in it."""

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
"""In the order in which they stand in the page; all in one scope of its own."""


def page_text(data: PageData) -> str:
    """HTML that needs nothing else, except its server where the frames are not in it."""
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
