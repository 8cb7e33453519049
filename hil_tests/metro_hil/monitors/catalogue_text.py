"""Signals and invariants as tables, for the document and the command line."""

from collections.abc import Sequence
from typing import Any, Final

from metro_hil.monitors.catalogue import INVARIANTS, Invariant
from metro_hil.monitors.vocabulary import SIGNALS, Origin, Signal

ORIGINS: Final = {
    Origin.TRUTH: "Truth of the plant",
    Origin.BUS: "Frames on the bus",
    Origin.LINE: "Truth, map and claims together",
}


def signal_row(signal: Signal) -> dict[str, Any]:
    return {
        "name": signal.name,
        "unit": signal.unit,
        "text": signal.text,
        "origin": signal.origin.value,
    }


def invariant_row(each: Invariant) -> dict[str, Any]:
    return {
        "name": each.name,
        "requirement": each.requirement,
        "text": each.text,
        "watched": each.watched,
        "unit": each.unit,
        "margin": each.margin,
        "why_not": each.why_not,
    }


def signal_tables() -> str:
    """Return the signals as Markdown, one table for each origin."""
    parts = []
    for origin, title in ORIGINS.items():
        rows = [
            f"| `{signal.name}` | {signal.unit} | {signal.text} |"
            for signal in SIGNALS
            if signal.origin is origin
        ]
        parts.append("\n".join([f"### {title}", "", *_table("signal", "unit", "meaning"), *rows]))
    return "\n\n".join(parts)


def invariant_tables() -> str:
    """Return the invariants as Markdown: the watched ones, then the others with the reason."""
    watched = [
        f"| `{each.name}` | {each.unit} | {each.text} | {each.margin} |"
        for each in INVARIANTS
        if each.watched
    ]
    others = [
        f"| {each.requirement} | {each.text} | {each.why_not} |"
        for each in INVARIANTS
        if not each.watched
    ]
    return "\n".join(
        [
            *_table("invariant", "unit", "what holds", "margin"),
            *watched,
            "",
            "Not watched:",
            "",
            *_table("requirement", "what holds", "why it is not watched"),
            *others,
        ]
    )


def _table(*titles: str) -> Sequence[str]:
    return (f"| {' | '.join(titles)} |", "|" + "---|" * len(titles))
