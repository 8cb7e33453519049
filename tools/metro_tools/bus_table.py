"""The buses of a machine as `vcan status` shows them."""

from collections.abc import Sequence
from dataclasses import dataclass

from firmware_py.buses.embedded import HubStatus
from metro_tools.vcan_plan import KernelLink


@dataclass(frozen=True, slots=True)
class BusRow:
    """One bus as `vcan status` shows it; None for values that a kind of bus does not report."""

    name: str
    kind: str
    up: bool
    bus: str
    """Value for the option --bus."""
    frames: int
    dropped: int
    clients: list[str] | None
    made_by_vcan: bool
    """`vcan down` may remove the bus."""


def link_row(link: KernelLink) -> BusRow:
    return BusRow(
        name=link.name,
        kind=f"kernel {link.kind}",
        up=link.is_up,
        bus=f"socketcan:{link.name}",
        frames=link.frames,
        dropped=link.dropped,
        clients=None,
        made_by_vcan=link.is_ours,
    )


def hub_row(hub: HubStatus) -> BusRow:
    return BusRow(
        name=hub.bus,
        kind="embedded",
        up=True,
        bus=f"embedded:{hub.bus}",
        frames=hub.frames,
        dropped=hub.dropped,
        clients=[client.node for client in hub.clients],
        made_by_vcan=not hub.bound,
    )


def table(rows: Sequence[BusRow]) -> str:
    """Format the rows as a table, one line each."""
    cells = [("name", "kind", "state", "frames", "dropped", "clients", "use --bus")]
    for row in rows:
        clients = "-" if row.clients is None else ",".join(row.clients) or "none"
        state = "up" if row.up else "down"
        cells.append(
            (row.name, row.kind, state, str(row.frames), str(row.dropped), clients, row.bus)
        )
    widths = [max(len(line[column]) for line in cells) for column in range(len(cells[0]))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in cells
    )
