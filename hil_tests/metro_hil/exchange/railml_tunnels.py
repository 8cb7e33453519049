"""Tunnels of railML 3: crossings over the track that are built as a tunnel."""

from collections.abc import Sequence
from typing import Any, Final

from firmware_py.trackdb.sites import TUNNELS
from metro_hil.exchange.railml_own import own_keys
from metro_hil.exchange.railml_places import RailmlPlaces
from metro_hil.exchange.surveyed_network import SurveyedZone
from metro_hil.exchange.xml_node import XmlNode

CROSSINGS: Final = (
    *("infrastructure", "functionalInfrastructure"),
    *("overCrossings", "overCrossing"),
)
TUNNEL: Final = "tunnel"
"""Value of `constructionType`; the other one is a bridge."""
DRAG_RATIO: Final = 1.6
"""Ratio of a foreign tunnel, which railML does not give: TTOBench has it for a FLIRT in 40 m²."""


def read_tunnels(root: XmlNode, places: RailmlPlaces) -> list[SurveyedZone]:
    """Read tunnels; those of an export of this project have their own ratio of air drag.

    Raises SettingsError.
    """
    found = []
    for node in root.all(*CROSSINGS):
        if (node.text("constructionType") or "").lower() != TUNNEL:
            continue
        keys: dict[str, Any] = {"drag_ratio": DRAG_RATIO, "name": node.name(), **own_keys(node)}
        name = str(keys.pop("name"))
        found += [
            SurveyedZone(TUNNELS, track, begin_m, end_m, name=name, values=keys)
            for track, begin_m, end_m, _, _ in places.ranges(node)
        ]
    return sorted(found, key=lambda each: each.begin_m)


def tunnel_notes(tunnels: Sequence[SurveyedZone]) -> tuple[str, ...]:
    """A sentence about the rule that filled the ratio of air drag."""
    if not any(each.values["drag_ratio"] == DRAG_RATIO for each in tunnels):
        return ()
    return (f"tunnels: drag_ratio {DRAG_RATIO:g} where the file gives none",)
