"""Version of this program: two hosts with the same version text compute the same results."""

import hashlib
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Final

from firmware_py import __version__

PACKAGES: Final = (
    *("can_dbc", "firmware_py", "metro_hil", "plant_emulator", "vobc", "zenoh_config"),
)
"""All packages that decide the result of a case."""
ENDINGS: Final = (".py", ".dbc", ".toml", ".json5")
DIGITS: Final = 12


@cache
def program_version() -> str:
    """Version and a hash over all sources, such as `0.1.0+3f2c9a0b12de`."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        _add(digest, package, resources.files(package))
    return f"{__version__}+{digest.hexdigest()[:DIGITS]}"


def _add(digest: "hashlib._Hash", name: str, folder: Traversable) -> None:
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        path = f"{name}/{entry.name}"
        if entry.is_dir():
            _add(digest, path, entry)
        elif entry.name.endswith(ENDINGS):
            content = hashlib.sha256(entry.read_bytes()).digest()
            digest.update(path.encode() + b"\0" + content)
