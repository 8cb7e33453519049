"""The supply of a network: which sections feed its tracks."""

from collections.abc import Iterator, Sequence
from math import ceil
from typing import Final

from firmware_py.settings import SettingsError
from firmware_py.trackdb.network import Running, Track, TrackNetwork
from firmware_py.trackdb.paths import TrackPlace
from metro_hil.model.network_places import NetworkAxis
from metro_hil.model.service import PlannedTrip
from plant_emulator.power.supplies import Supply, check_feeds, load_supply

PLACE_STEP_M: Final = 25.0
"""Step in which a track is checked for sections that feed it."""


def supply_of(name: str, network: TrackNetwork, trips: Sequence[PlannedTrip]) -> Supply:
    """Load a supply that fits the network, see `check_supply`. Raises SettingsError."""
    supply = load_supply(name)
    check_supply(supply, name, network, trips)
    return supply


def check_supply(
    supply: Supply, name: str, network: TrackNetwork, trips: Sequence[PlannedTrip]
) -> None:
    """Check that a supply feeds all tracks of the trips, and that each section feeds a track.

    Raises SettingsError.

    Args:
        name: name or path of the supply in messages.
    """
    axis = NetworkAxis(network)
    used = {leg.track.name: leg.track for trip in trips for leg in trip.path.legs}
    check_feeds(supply, name, (place for track in used.values() for place in _along(axis, track)))
    stretches_m = [axis.stretch_m(track.name) for track in network.tracks]
    for section in supply.sections:
        low_m, high_m = sorted((section.begin_m, section.end_m))
        if not any(start_m < high_m and low_m < end_m for start_m, end_m in stretches_m):
            first_m, last_m = min(map(min, stretches_m)), max(map(max, stretches_m))
            raise SettingsError(
                f"supply {name}: sections: {section.begin}-{section.end} from {low_m:g} m to "
                f"{high_m:g} m feeds no track of {network.name}, whose tracks lie from "
                f"{first_m:g} m to {last_m:g} m"
            )


def _along(axis: NetworkAxis, track: Track) -> Iterator[tuple[str, float]]:
    """Places along a track, for `check_feeds`."""
    length_m = track.end_m - track.start_m
    steps = ceil(length_m / PLACE_STEP_M)
    for step in range(steps + 1):
        place = TrackPlace(track.name, track.start_m + length_m * step / steps, Running.UP)
        yield f"track {track.name}", axis.place_m(place)
