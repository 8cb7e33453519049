"""Writes a search's results: its history, and a campaign that repeats the worst cases."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import tomli_w

from firmware_py.storage.whole_file import named, write_whole
from metro_hil.campaign.tables import ConfigTable
from metro_hil.search.find import Sought
from metro_hil.search.space import SearchSpace

HISTORY: Final = "history.jsonl"
WORST: Final = "worst.toml"
FILES: Final = "files"
NAMED: Final = ("line", "consist", "params")


def append_history(folder: Path, new: Sequence[Sought]) -> None:
    """Append one JSON object a line to the history. Raises OSError."""
    lines = b"".join(msgspec.json.encode(sought) + b"\n" for sought in new)
    with named(folder / HISTORY), (folder / HISTORY).open("ab") as history:
        history.write(lines)


def write_worst(
    folder: Path, space: SearchSpace, worst: Sequence[Sought], files: Mapping[str, str]
) -> Path:
    """Write a campaign file of the worst cases, the worst first, with the user's files it needs.

    Raises OSError.
    """
    path = folder / WORST
    tables = [_scenario(space, sought, place) for place, sought in enumerate(worst, start=1)]
    written = {name for table in tables for name in _localised(table, space)}
    document: dict[str, Any] = {
        "title": f"Worst cases found of {space.plan.name}",
        "scenario": tables,
    }
    for name in sorted(written):
        (folder / FILES).mkdir(exist_ok=True)
        write_whole(folder / FILES / name, files[name])
    write_whole(path, tomli_w.dumps(document))
    return path


def _scenario(space: SearchSpace, sought: Sought, place: int) -> ConfigTable:
    table = space.table(sought.values)
    for name in ("layout", "seed_base", "name", "title"):
        table.pop(name, None)
    least = min(sought.margins.items(), key=lambda item: item[1], default=None)
    words = "" if least is None else f": {least[0]} {least[1]:.4g}"
    return {
        **table,
        "name": f"worst-{place}",
        "title": f"{sought.case_id} of the search{words}",
        "seeds": [sought.seed],
        "stop_at_violation": False,
    }


def _localised(table: ConfigTable, space: SearchSpace) -> list[str]:
    """Change a scenario's table to name the copies of the user's files; return their names."""
    train = dict(table.get("train", {}))
    copied: list[str] = []
    sources = space.body.sources
    getters: dict[str, Any] = {
        "line": sources.line,
        "consist": sources.train,
        "params": sources.params,
    }
    for key in NAMED:
        if key not in train:
            continue
        name = getters[key](train[key])[0]
        if name in sources.files:
            train[key] = f"{FILES}/{name}"
            copied.append(name)
    if train:
        table["train"] = train
    return copied
