"""Keys of line files that railML has no place for, as designators in a register of this project."""

import json
from typing import Any, Final

from firmware_py.trackdb.sites import POWER, ZONES
from metro_hil.exchange.xml_node import XmlNode

REGISTER: Final = "metro VOBC bench"
"""Register of designators whose entry is a JSON object with keys of line files."""

OWN_ZONES: Final = tuple(key for key in ZONES if key != POWER)
"""Keys of a line whose zones lie on its only netElement, by the chainage of the line."""


def own_keys(node: XmlNode) -> dict[str, Any]:
    """Keys that an export of this project added to an element. Raises SettingsError."""
    for designator in node.all("designator"):
        if designator.text("register") != REGISTER:
            continue
        entry = designator.need("entry", "write a JSON object, or remove the designator")
        try:
            found = json.loads(entry)
        except ValueError:
            found = None
        if not isinstance(found, dict):
            raise designator.error(f"entry: {entry!r} is not a JSON object; export the line again")
        return found
    return {}


def tag_keys(node: XmlNode) -> dict[str, Any]:
    """Keys of a tag, or nothing for a foreign balise."""
    keys = own_keys(node)
    return keys if "tag_id" in keys else {}
