"""Scenarios of the lines and the train that `vobc import` wrote into a folder."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from firmware_py import settings
from firmware_py.settings import SettingsError

PARTS: Final[Mapping[str, str]] = {
    "line": "stations",
    "network": "tracks",
    "consist": "brake",
    "params": "atp",
}
"""The kinds of files, and a key that only files of that kind have."""


def imported_scenarios(folder: str) -> list[dict[str, Any]]:
    """One scenario for each line and each route of the folder, with its train or the default one.

    Raises:
        SettingsError: there is no line, or it is unclear which train belongs to the lines.
    """
    found = _sorted_files(Path(folder))
    ways = [(path.stem, str(path.resolve())) for path in found["line"]]
    for path in found["network"]:
        for route in settings.parse(path).get("routes", []):
            name = str(route.get("name", ""))
            ways.append((f"{path.stem}-{name}", f"{path.resolve()}:{name}"))
    if not ways:
        raise SettingsError(
            f"--with {folder}: holds no line file (*.toml with 'stations') and no network with "
            "routes; name the folder that `vobc import --out` wrote"
        )
    train: dict[str, str] = {}
    for kind in ("consist", "params"):
        if len(found[kind]) > 1:
            names = ", ".join(path.name for path in found[kind])
            raise SettingsError(
                f"--with {folder}: {names}: more than one file of kind {kind}; keep one train in "
                "each folder, as platforms are laid out for it"
            )
        if found[kind]:
            train[kind] = str(found[kind][0].resolve())
    if len(train) == 1:
        given, missing = ("consist", "params") if "consist" in train else ("params", "consist")
        name = found[given][0].name
        raise SettingsError(
            f"--with {folder}: {name} has no {missing} beside it; a train needs both"
        )
    suffix = f"-{found['consist'][0].stem}" if train else ""
    return [
        {
            "name": f"{name}{suffix}",
            "title": f"Imported line {name}",
            "train": {"line": line, **train},
        }
        for name, line in ways
    ]


def _sorted_files(folder: Path) -> dict[str, list[Path]]:
    """The files of the folder by kind; others, such as campaigns, are left out."""
    if not folder.is_dir():
        raise SettingsError(f"--with {folder}: is not a folder")
    found: dict[str, list[Path]] = {kind: [] for kind in PARTS}
    for path in sorted(folder.glob("*.toml")):
        table = settings.parse(path)
        for kind, key in PARTS.items():
            if key in table and "scenario" not in table:
                found[kind].append(path)
                break
    return found
