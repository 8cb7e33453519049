"""Puts a page of the bench together from its template, styles and script."""

from importlib.resources import files
from typing import Final

STYLE: Final = "metro_hil.report.campaign.templates"
"""Package with the style that all pages of the bench share."""


def bench_page(name: str, **more: str) -> str:
    """Return the page with this name as one HTML file.

    Args:
        more: further parts of its template, each under its name in double braces.
    """
    own = files("metro_hil.watch") / "page"
    style = files(STYLE).joinpath("style.css").read_text(encoding="utf-8")
    parts = {
        **more,
        "style": style + (own / f"{name}.css").read_text(encoding="utf-8"),
        "script": (own / f"{name}.js").read_text(encoding="utf-8"),
    }
    text = (own / f"{name}.html").read_text(encoding="utf-8")
    for part, content in parts.items():
        text = text.replace(f"{{{{{part}}}}}", content)
    return text
