"""`hil monitors`: shows the watched invariants, and the signals of expressions."""

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from firmware_py.settings import SettingsError, nearest
from metro_hil.model.run_options import EXIT_OK
from metro_hil.model.terminal import console_for

if TYPE_CHECKING:
    from metro_hil.monitors.catalogue import Invariant
    from metro_hil.monitors.vocabulary import Signal


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "monitors",
        help="show the invariants and the signals of expressions",
        description="Show which invariants are watched during a run, which are not and why, and "
        "the signals that a scenario's expressions can use.",
    )
    parser.add_argument(
        "name", nargs="?", metavar="NAME", help="an invariant by name or number, or a signal"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Raises SettingsError, with the nearest valid name, for an unknown name."""
    from metro_hil.monitors.catalogue import INVARIANTS
    from metro_hil.monitors.vocabulary import SIGNALS

    invariants: Sequence[Invariant] = INVARIANTS
    signals: Sequence[Signal] = SIGNALS
    if options.name is not None:
        invariants, signals = _named(options.name)
    if options.json:
        import msgspec

        from metro_hil.monitors.catalogue_text import invariant_row, signal_row

        rows = {
            "invariants": [invariant_row(each) for each in invariants],
            "signals": [signal_row(each) for each in signals],
        }
        print(msgspec.json.encode(rows).decode())
    elif options.name is not None:
        _print_some(invariants, signals)
    else:
        _print_all(invariants, signals)
    return EXIT_OK


def _named(name: str) -> "tuple[Sequence[Invariant], Sequence[Signal]]":
    from metro_hil.monitors.catalogue import INVARIANTS
    from metro_hil.monitors.plan import invariants_named
    from metro_hil.monitors.vocabulary import NAMES, SIGNALS

    invariants = invariants_named(name)
    signals = [signal for signal in SIGNALS if signal.name == name]
    if not invariants and not signals:
        known = [*(each.name for each in INVARIANTS), *NAMES]
        raise SettingsError(f"monitors: {name!r}: unknown; {nearest(name, known, 'name')}")
    return invariants, signals


def _print_some(invariants: "Sequence[Invariant]", signals: "Sequence[Signal]") -> None:
    for each in invariants:
        print(f"{each.name}  {each.requirement}" + (f"  [{each.unit}]" if each.watched else ""))
        print(f"  {each.text}")
        print(f"  Margin: {each.margin}" if each.watched else f"  Not watched: {each.why_not}.")
    for signal in signals:
        print(f"{signal.name}  [{signal.unit}]\n  {signal.text}")


def _print_all(invariants: "Sequence[Invariant]", signals: "Sequence[Signal]") -> None:
    from rich.table import Table

    from metro_hil.monitors.catalogue_text import ORIGINS

    console = console_for(highlight=False, markup=False)
    table = Table(title="Invariants", title_justify="left", box=None)
    for column in ("name", "unit", "what holds, or why it is not watched"):
        table.add_column(column, overflow="fold")
    for each in invariants:
        words = each.text if each.watched else f"{each.text} Not watched: {each.why_not}."
        table.add_row(each.name, each.unit or "-", words)
    console.print(table)
    for origin, title in ORIGINS.items():
        table = Table(title=f"\n{title}", title_justify="left", box=None)
        for column in ("signal", "unit", "meaning"):
            table.add_column(column, overflow="fold")
        for signal in signals:
            if signal.origin is origin:
                table.add_row(signal.name, signal.unit, signal.text)
        console.print(table)
