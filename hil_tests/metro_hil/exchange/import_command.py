"""`vobc import`: turns foreign descriptions of lines and trains into files of this project."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import tomli_w

from firmware_py.command_line import CommandParser
from firmware_py.settings import SettingsError, text_of
from firmware_py.storage.whole_file import write_whole
from metro_hil.exchange.effort_curve import with_effort
from metro_hil.exchange.line_rules import FittedTrain, complete_line
from metro_hil.exchange.motor_tables import MotorTable, read_consist, read_table, with_tables
from metro_hil.exchange.network_rules import complete_network
from metro_hil.exchange.railjson_line import read_infra
from metro_hil.exchange.railjson_train import read_rolling_stock
from metro_hil.exchange.railml_network import check_version, read_infrastructure
from metro_hil.exchange.railml_train import no_infrastructure_nor_stock
from metro_hil.exchange.railml_train import read_rolling_stock as read_formation
from metro_hil.exchange.survey import Element, SurveyedLine, SurveyedTrain, read_json
from metro_hil.exchange.surveyed_network import SurveyedNetwork, branches, line_along
from metro_hil.exchange.train_rules import complete_train, fitted
from metro_hil.exchange.ttobench import read_file
from metro_hil.exchange.xml_node import XmlNode, is_xml, read_xml
from metro_hil.model.run_options import EXIT_OK, EXIT_USAGE
from vobc.config import load_config

PROG: Final = "vobc import"
DESCRIPTION: Final = (
    "Turn tracks and trains of TTOBench (JSON), infrastructure and rolling stock of railML 3 (XML) "
    "and of OSRD (RailJSON) into a line or network file, a consist and parameters, and tables of "
    "motors (CSV) into the consist. What a file does not say is filled by rules, which are printed "
    "and stand at the top of each file."
)
EPILOG: Final = "exit codes: 0 the files are written; 2 wrong usage or a bad file; nothing written"
PARAMS: Final = "florence4"
EFFORT_PLACE: Final = "traction.effort"


@dataclass(frozen=True, slots=True)
class ImportChoices:
    """What the user chooses from a file."""

    stops: tuple[str, ...] | None = None
    """Stations in running order; None: all of a single track, or the whole network."""
    formation: str | None = None
    """Name of the train in a file of several; None: the only one."""


Surveyed = SurveyedLine | SurveyedNetwork | SurveyedTrain


def parser() -> argparse.ArgumentParser:
    """The command line of `vobc import`."""
    top = CommandParser(prog=PROG, description=DESCRIPTION, epilog=EPILOG)
    top.add_argument(
        "files",
        nargs="+",
        metavar="FILE",
        help="tracks, at most one train that runs on them or consist (TOML), and CSV tables of its "
        "motors: speed_kmh or speed_mps, then effort_kn, effort_n, brake_kn or brake_n, or "
        "efficiencies at loads, such as traction_0.1,traction_1.0 or brake_0.1,brake_1.0",
    )
    top.add_argument(
        "--stops",
        metavar="NAME,NAME",
        help="stations of RailJSON or railML in running order; default: all, or the whole network "
        "if a track branches",
    )
    top.add_argument("--formation", metavar="NAME", help="train of a railML file that has several")
    top.add_argument(
        "--params",
        metavar="NAME|FILE",
        help="train that lines are laid out for; default: the imported one, else florence4",
    )
    top.add_argument("--out", default=".", metavar="DIR", help="default: this folder")
    top.add_argument("--force", action="store_true", help="replace files that exist")
    return top


def main(argv: Sequence[str]) -> int:
    """Write the files and print the rules, or print what is wrong with the first bad file."""
    options = parser().parse_args(argv)
    try:
        stops = None
        if options.stops is not None:
            stops = tuple(name.strip() for name in options.stops.split(","))
        chosen = ImportChoices(stops, options.formation)
        written, hint = files_of(options.files, options.params, chosen)
        folder = Path(options.out)
        _check_free(folder, written, options.force)
    except SettingsError as error:
        print(f"{PROG}: {error}", file=sys.stderr)
        return EXIT_USAGE
    folder.mkdir(parents=True, exist_ok=True)
    for name, (table, notes) in written.items():
        write_whole(folder / name, file_text(table, notes))
        print(f"wrote {folder / name}")
        for note in notes:
            print(f"  {note}")
    print(f"next: {hint.format(folder=_prefix(folder))}")
    return EXIT_OK


def file_text(table: dict[str, Any], notes: Sequence[str]) -> str:
    """A file with its rules as comment at the top."""
    head = ["# Made by `vobc import`. What the imported file does not say, it filled like this:"]
    lines = [*head, *(f"# - {note}" for note in notes)] if notes else ["# Made by `vobc import`."]
    return "\n".join([*lines, "", tomli_w.dumps(table)])


def files_of(
    names: Sequence[str], params: str | None, options: ImportChoices
) -> tuple[dict[str, tuple[dict[str, Any], tuple[str, ...]]], str]:
    """Table and rules of each file to write, and the command to try next. Raises SettingsError."""
    tables = [read_table(Path(name)) for name in names if name.lower().endswith(".csv")]
    consists = [Path(name) for name in names if name.lower().endswith(".toml")]
    others = [name for name in names if not name.lower().endswith((".csv", ".toml"))]
    lines, trains = _surveyed(others, options)
    _check_one_train(tables, consists, trains)
    written: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {}
    used, words = params or PARAMS, ""
    for path in consists:
        table, notes = with_tables(read_consist(path), tables, path.name)
        words = f" --consist {{folder}}{path.name}"
        _add(written, path.name, table, notes)
    if trains:
        if params is not None:
            raise SettingsError(
                f"--params {params}: not with the train {trains[0].source}, which lines are laid "
                "out for; leave one of them out"
            )
        name, train = trains[0].name, _add_train(written, trains[0], tables)
        used, words = f"{{folder}}{name}_params.toml", f" --consist {{folder}}{name}.toml"
    else:
        config = load_config(used)
        train = FittedTrain(config.name, config.train.length_m, config.train.antenna_offset_m)
    routes: list[str] = []
    for line in lines:
        if isinstance(line, SurveyedNetwork):
            done = complete_network(line, train)
            routes += [f":{route['name']}" for route in done.table["routes"]]
        else:
            done = complete_line(line, train)
        _add(written, f"{line.name}.toml", done.table, done.notes)
    line_name = f"{{folder}}{lines[0].name}.toml" if lines else "florence"
    params_words = f" --params {used}" if used != PARAMS else ""
    if lines and isinstance(lines[0], SurveyedNetwork):
        check = f"vobc network check {line_name}{params_words}"
        run = f"{check}; vobc run --lockstep --line {line_name}{''.join(routes[:1])}"
        return written, f"{run}{words}{params_words}" if routes else check
    run = f"vobc check --line {line_name}{params_words}; "
    return written, f"{run}vobc run --lockstep --line {line_name}{words}{params_words}"


def _add_train(
    written: dict[str, tuple[dict[str, Any], tuple[str, ...]]],
    train: SurveyedTrain,
    tables: Sequence[MotorTable],
) -> FittedTrain:
    """Add consist and parameters of a foreign train. Its effort comes before the parameters."""
    effort = [each for each in tables if each.place == EFFORT_PLACE]
    rest = [each for each in tables if each not in effort]
    for each in effort:
        train = with_effort(train, each)
    consist, own = complete_train(train)
    table, notes = with_tables(consist.table, rest, train.source)
    _add(written, f"{train.name}.toml", table, (*consist.notes, *notes))
    _add(written, f"{train.name}_params.toml", own.table, own.notes)
    return fitted(train, own.table)


def _surveyed(
    names: Sequence[str], options: ImportChoices
) -> tuple[list[SurveyedLine | SurveyedNetwork], list[SurveyedTrain]]:
    read = [each for name in names for each in _read(Path(name), options)]
    lines = [each for each in read if not isinstance(each, SurveyedTrain)]
    trains = [each for each in read if isinstance(each, SurveyedTrain)]
    if options.formation is not None and not trains:
        raise SettingsError(
            f"--formation {options.formation}: no file has rolling stock; leave it out"
        )
    if len(trains) > 1:
        raise SettingsError(
            f"{trains[1].source}: a second train, after {trains[0].source}; platforms are laid "
            "out for one; import the other into another folder"
        )
    return lines, trains


def _check_one_train(
    tables: Sequence[MotorTable], consists: Sequence[Path], trains: Sequence[SurveyedTrain]
) -> None:
    if len(consists) + len(trains) > 1:
        raise SettingsError(f"{consists[-1]}: a second train; import it separately")
    if consists and not tables:
        raise SettingsError(f"{consists[0]}: is a file of this project already; give CSV tables")
    if tables and not (consists or trains):
        raise SettingsError(
            f"{tables[0].source}: a table of motors belongs to one train; give the file of the "
            "train, too"
        )
    for number, table in enumerate(tables):
        if table.place in [each.place for each in tables[:number]]:
            raise SettingsError(f"{table.source}: a second table for {table.place}; give one")


def _read(path: Path, options: ImportChoices) -> list[Surveyed]:
    """Read a file of any known format. Raises SettingsError."""
    if is_xml(text_of(path)):
        return _read_railml(read_xml(path), options)
    return [_read_json(read_json(path), options)]


def _read_railml(root: XmlNode, options: ImportChoices) -> list[Surveyed]:
    """The tracks and the train of a railML file."""
    check_version(root)
    found: list[Surveyed] = []
    if root.first("infrastructure", "topology") is not None:
        found.append(_tracks(read_infrastructure(root), options))
    if root.first("rollingstock", "formations") is not None:
        found.append(read_formation(root, options.formation))
    if not found:
        raise no_infrastructure_nor_stock(root)
    return found


def _tracks(network: SurveyedNetwork, options: ImportChoices) -> SurveyedLine | SurveyedNetwork:
    """The line through the named stops, or the whole network if it branches or was exported."""
    if options.stops is None and (network.given or branches(network)):
        return network
    return line_along(network, options.stops or ())


def _read_json(file: Element, options: ImportChoices) -> Surveyed:
    stops = options.stops
    if file.has("track_sections"):
        return _tracks(read_infra(file), options)
    if stops is not None and file.has("stops"):
        raise SettingsError(
            f"--stops {','.join(stops)}: not with {file.source}, which lists its stops; leave it "
            "out"
        )
    return read_rolling_stock(file) if file.has("effort_curves") else read_file(file)


def _add(
    written: dict[str, tuple[dict[str, Any], tuple[str, ...]]],
    name: str,
    table: dict[str, Any],
    notes: tuple[str, ...],
) -> None:
    if name in written:
        raise SettingsError(f"{name}: two of the files have this id; import them separately")
    written[name] = (table, notes)


def _check_free(folder: Path, names: Sequence[str] | dict[str, Any], force: bool) -> None:
    if folder.exists() and not folder.is_dir():
        raise SettingsError(f"--out {folder}: is not a folder")
    for name in names:
        if (folder / name).exists() and not force:
            raise SettingsError(f"{folder / name}: exists; give --force to replace it")


def _prefix(folder: Path) -> str:
    return "" if folder == Path() else f"{folder}/"
