"""`hil export`: writes the shipped train or controller as an FMU with CAN by FMI-LS-BUS."""

import argparse

from metro_hil.cli.hil.working import number
from metro_hil.model.run_options import EXIT_ENVIRONMENT, EXIT_OK

WHAT = ("train", "controller")


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "export",
        help="write the train or the controller as an FMU with CAN",
        description="Write the shipped train or controller as an FMU of FMI 3.0 for this machine, "
        "with CAN by FMI-LS-BUS 1.0. It needs a C compiler.",
    )
    parser.add_argument("what", choices=WHAT, help="the side of the bus that the FMU is")
    parser.add_argument("--out", metavar="FILE", help="default: train.fmu or controller.fmu")
    parser.add_argument("--line", default="florence", metavar="NAME|FILE", help="default: florence")
    parser.add_argument(
        "--from", dest="start", metavar="STATION", help="default: the first of the line"
    )
    parser.add_argument("--to", dest="end", metavar="STATION", help="default: the last of the line")
    parser.add_argument(
        "--consist", default="florence4", metavar="NAME|FILE", help="default: florence4"
    )
    parser.add_argument(
        "--params",
        default="florence4",
        metavar="NAME|FILE",
        help="what the controller believes of its train; default: florence4",
    )
    parser.add_argument(
        "--seed", type=number(0), default=1, metavar="N", help="seed of the train; default: 1"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Exit code 0 if the files are written. Raises SettingsError."""
    import sys
    from pathlib import Path

    from firmware_py.native.build import BuildError
    from metro_hil.fmi_export.sides import write_controller, write_train
    from metro_hil.model.run_options import parse

    path = Path(options.out or f"{options.what}.fmu")
    words = ["run", "--lockstep", "--seed", str(options.seed)]
    for name in ("line", "consist", "params"):
        words += [f"--{name}", getattr(options, name)]
    for name, station in (("--from", options.start), ("--to", options.end)):
        words += [] if station is None else [name, station]
    write = write_train if options.what == "train" else write_controller
    try:
        written = write(path, parse(words))
    except BuildError as error:
        print(f"hil: {error}", file=sys.stderr)
        return EXIT_ENVIRONMENT
    for each in written:
        print(f"written: {each}")
    return EXIT_OK
