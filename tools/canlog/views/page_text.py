"""Builds the page of a log as one text, with its style, scripts and data."""

import html
import json
from collections.abc import Mapping
from importlib import resources
from typing import Any, Final

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
    "drive.js",
    "live.js",
    "faults.js",
    "app.js",
)
"""Scripts in the order in which they stand in the page; they share one scope."""


def page_text(data: PageData) -> str:
    """Return HTML that needs no other file, only its server if the frames are not included."""
    return html_page(data.head, "" if data.head["remote"] else data.block.text())


def html_page(head: Mapping[str, Any], block: str = "") -> str:
    """Return the page of a log, or the live page, from its head and its packed frames."""
    script = "\n".join(part(name) for name in SCRIPTS)
    parts = {
        "title": html.escape(str(head["title"])),
        "style": part("style.css"),
        "head": json_text(head),
        "block": block,
        "script": f'(() => {{\n"use strict";\n{script}\n}})();',
    }
    pieces = part("index.html").split("{{")
    filled = [pieces[0]]
    for piece in pieces[1:]:
        name, _, rest = piece.partition("}}")
        filled += (parts[name], rest)
    return "".join(filled)


def json_text(head: Mapping[str, Any]) -> str:
    """Return JSON that is safe inside an HTML page."""
    return json.dumps(head, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")


def part(name: str) -> str:
    return (resources.files("canlog.views") / "page" / name).read_text("utf-8")
