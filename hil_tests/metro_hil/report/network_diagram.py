"""Draws the tracks of a network as a diagram in SVG, one lane for each track."""

import html
from collections.abc import Iterator
from typing import Final

from firmware_py.trackdb.network import Track, TrackNetwork, TrackZone
from firmware_py.trackdb.sites import POWER, TunnelSection
from metro_hil.model.network_places import ends_m

WIDTH_PX: Final = 1100.0
MARGIN_PX: Final = 90.0
LANE_PX: Final = 70.0
STYLE: Final = (
    "text{font:12px sans-serif;fill:#222}.track{stroke:#222;stroke-width:4}"
    ".joint{stroke:#888;stroke-width:3;fill:none}.platform{fill:#e8a33d}"
    ".stop{stroke:#b00020;stroke-width:5}"
    ".crossing{stroke:#b00020;stroke-width:2;stroke-dasharray:4 3}"
    ".neutral{stroke:#2b6cb0;stroke-width:10;stroke-opacity:.5}"
    ".evacuation{stroke:#2f855a;stroke-width:10;stroke-opacity:.5}"
    ".tunnel{stroke:#718096;stroke-width:18;stroke-opacity:.35}"
    ".power{stroke:#805ad5;stroke-width:3;stroke-dasharray:12 3}"
    ".no-stop{stroke:#b7791f;stroke-width:10;stroke-opacity:.5}"
)

KINDS: Final = {
    "tunnels": "tunnel",
    "neutral_sections": "neutral section",
    "power_sections": "power section",
    "no_stop_zones": "no-stop zone",
    "evacuation_stops": "evacuation stop",
}
"""Keys of a track that have zones, with what one zone is called."""
POWER_PX: Final = 18.0
"""Height of the contact line above its track."""


def network_svg(network: TrackNetwork) -> str:
    """The diagram as a document. Tracks keep their lengths; places where they meet are level."""
    placed_m = ends_m(network)
    low_m, high_m = min(placed_m.values()), max(placed_m.values())
    scale = (WIDTH_PX - 2.0 * MARGIN_PX) / (high_m - low_m)
    places = {end: MARGIN_PX + (at_m - low_m) * scale for end, at_m in placed_m.items()}
    lanes = {track.name: LANE_PX * (row + 1) for row, track in enumerate(network.tracks)}
    height_px = LANE_PX * (len(network.tracks) + 1)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH_PX:.0f}" height="{height_px:.0f}">',
        f"<style>{STYLE}</style>",
        f'<text x="10" y="20">{html.escape(network.name)}</text>',
        *_joints(network, places, lanes),
    ]
    for track in network.tracks:
        parts += _track(track, places, lanes[track.name])
    for end in network.buffer_stops:
        x_px, y_px = places[end], lanes[end.rpartition(".")[0]]
        parts.append(_line("stop", x_px, y_px - 8.0, x_px, y_px + 8.0))
    parts += _crossings(network, places, lanes)
    return "\n".join([*parts, "</svg>", ""])


def zones_of(track: Track) -> Iterator[tuple[str, TrackZone | TunnelSection]]:
    """The zones and tunnels of a track, each with its kind."""
    for key, kind in KINDS.items():
        for zone in getattr(track, key):
            yield kind, zone


def _joints(
    network: TrackNetwork, places: dict[str, float], lanes: dict[str, float]
) -> Iterator[str]:
    pairs = [(join.a, join.b, "") for join in network.joins]
    for switch in network.switches:
        pairs += [(switch.tip, switch.left, switch.name), (switch.tip, switch.right, "")]
    for one, other, name in pairs:
        x_px, y_px = places[one], lanes[one.rpartition(".")[0]]
        yield _line("joint", x_px, y_px, places[other], lanes[other.rpartition(".")[0]])
        if name:
            yield _text(x_px + 4.0, y_px - 8.0, name)


def _crossings(
    network: TrackNetwork, places: dict[str, float], lanes: dict[str, float]
) -> Iterator[str]:
    """A broken line from the place of each crossing on one track to that on the other."""
    for crossing in network.crossings:
        (one_px, one_y_px), (other_px, other_y_px) = (
            (_at_px(network.track(name), at_m, places), lanes[name])
            for name, at_m in ((crossing.a, crossing.a_m), (crossing.b, crossing.b_m))
        )
        yield _line("crossing", one_px, one_y_px, other_px, other_y_px)
        yield _text((one_px + other_px) / 2.0 + 4.0, (one_y_px + other_y_px) / 2.0, crossing.name)


def _at_px(track: Track, at_m: float, places: dict[str, float]) -> float:
    start_px, end_px = places[f"{track.name}.start"], places[f"{track.name}.end"]
    return start_px + (at_m - track.start_m) / (track.end_m - track.start_m) * (end_px - start_px)


def _track(track: Track, places: dict[str, float], y_px: float) -> Iterator[str]:
    start_px, end_px = places[f"{track.name}.start"], places[f"{track.name}.end"]
    share = (end_px - start_px) / (track.end_m - track.start_m)
    yield _line("track", start_px, y_px, end_px, y_px)
    yield _text(min(start_px, end_px) - 60.0, y_px + 4.0, track.name)
    for kind, zone in zones_of(track):
        from_px, to_px = (
            start_px + (at_m - track.start_m) * share for at_m in (zone.start_m, zone.end_m)
        )
        if kind == KINDS[POWER]:
            yield from _power_section(zone.name, from_px, to_px, y_px - POWER_PX)
            continue
        yield _line(kind.partition(" ")[0], from_px, y_px, to_px, y_px)
        yield _text(min(from_px, to_px), y_px - 16.0, zone.name or kind)
    for edge in track.platforms:
        one_px = start_px + (edge.start_m - track.start_m) * share
        other_px = start_px + (edge.end_m - track.start_m) * share
        left_px, width_px = min(one_px, other_px), max(2.0, abs(other_px - one_px))
        # Right of a track that runs up towards the right is below it.
        sides_px = (y_px + 6.0, y_px - 14.0)[:: 1 if share > 0.0 else -1]
        for is_there, top_px in zip((edge.side.right, edge.side.left), sides_px, strict=True):
            if is_there:
                yield (
                    f'<rect class="platform" x="{left_px:.1f}" y="{top_px:.1f}" '
                    f'width="{width_px:.1f}" height="8"/>'
                )
        yield _text(left_px, y_px + 28.0, edge.station)


def _power_section(name: str, from_px: float, to_px: float, y_px: float) -> Iterator[str]:
    """The contact line of a section, with an insulator at both ends."""
    yield _line("power", from_px, y_px, to_px, y_px)
    for x_px in (from_px, to_px):
        yield _line("joint", x_px, y_px - 4.0, x_px, y_px + 4.0)
    yield _text(min(from_px, to_px) + 2.0, y_px - 5.0, name)


def _line(kind: str, x1_px: float, y1_px: float, x2_px: float, y2_px: float) -> str:
    return (
        f'<line class="{kind}" x1="{x1_px:.1f}" y1="{y1_px:.1f}" x2="{x2_px:.1f}" '
        f'y2="{y2_px:.1f}"/>'
    )


def _text(x_px: float, y_px: float, text: str) -> str:
    return f'<text x="{x_px:.1f}" y="{y_px:.1f}">{html.escape(text)}</text>'
