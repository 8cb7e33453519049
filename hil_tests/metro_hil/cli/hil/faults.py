"""`hil faults`: shows the catalogue of faults, or one of them in full."""

import argparse
import difflib
from typing import TYPE_CHECKING, Any

from firmware_py.settings import SettingsError
from metro_hil.model.run_options import EXIT_OK
from metro_hil.model.terminal import console_for
from plant_emulator.faults.kinds import FaultPlace

if TYPE_CHECKING:
    from plant_emulator.faults.described import Described


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "faults",
        help="show the catalogue of faults",
        description="Show the catalogue of faults, or one of them in full: what it does, its "
        "parameters, its possible consequences, and how each bench produces it.",
    )
    parser.add_argument("kind", nargs="?", metavar="KIND", help="show only this one, in full")
    places = ", ".join(place.value for place in FaultPlace)
    parser.add_argument("--place", metavar="P", help=f"show only faults at this place: {places}")
    parser.add_argument("--json", action="store_true", help="one JSON array on standard output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Raises SettingsError, with the nearest valid name, for an unknown kind or place."""
    from plant_emulator.faults.described import all_described

    known = all_described()
    if options.place is not None:
        places = {place.value: place for place in FaultPlace}
        place = places[_found("place", options.place, list(places))]
        known = tuple(each for each in known if each.place is place)
    if options.kind is not None:
        kind = _found("kind", options.kind, [each.name for each in known])
        known = tuple(each for each in known if each.name == kind)
    if options.json:
        import msgspec

        print(msgspec.json.encode([_json(each) for each in known]).decode())
    elif options.kind is not None:
        _print_one(known[0])
    else:
        _print_all(known)
    return EXIT_OK


def _found(what: str, name: str, known: list[str]) -> str:
    if name in known:
        return name
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"nearest valid {what}: {close[0]}" if close else f"valid {what}s: {', '.join(known)}"
    raise SettingsError(f"faults: {what} {name!r}: unknown; {hint}")


def _json(each: "Described") -> dict[str, Any]:
    import msgspec

    found: dict[str, Any] = msgspec.to_builtins(each)
    return found


def _print_all(known: "tuple[Described, ...]") -> None:
    from rich.table import Table

    from plant_emulator.faults.described import PLACE_TITLES

    console = console_for(highlight=False, markup=False)
    for place in FaultPlace:
        here = [each for each in known if each.place is place]
        if not here:
            continue
        table = Table(
            title=f"{PLACE_TITLES[place]} ({place.value})", title_justify="left", box=None
        )
        table.add_column("kind", no_wrap=True)
        table.add_column("what it does")
        table.add_column("parameters")
        for each in here:
            table.add_row(each.name, each.story, ", ".join(p.name for p in each.parameters))
        console.print(table)
        console.print()
    console.print("hil faults KIND shows one of them in full.")


def _print_one(each: "Described") -> None:
    from rich.table import Table

    from plant_emulator.faults.described import PLACE_TITLES

    console = console_for(highlight=False, markup=False)
    console.print(f"{each.name} ({PLACE_TITLES[each.place]})", style="bold")
    console.print(each.story)
    console.print()
    if each.parameters:
        table = Table(box=None)
        for head in ("parameter", "value", "unit", "default", "range", "meaning"):
            table.add_column(head, no_wrap=head == "parameter")
        for one in each.parameters:
            table.add_row(one.name, one.kind, one.unit, one.default, one.range, one.story)
        console.print(table)
        console.print()
    console.print(f"possible consequences: {'; '.join(each.hazards)}")
    console.print(f"in lockstep: {each.benches.lockstep}")
    console.print(f"with processes: {each.benches.processes}")
    console.print(f"on hardware: {each.benches.hardware}")
