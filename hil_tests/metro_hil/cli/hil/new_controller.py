"""`hil new-controller`: a small project for a controller of one's own, which drives as written."""

import argparse
import re
from pathlib import Path
from typing import Final

from metro_hil.model.run_options import EXIT_OK

NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
LANGUAGES: Final = ("c", "cpp", "python", "rust")
TARGETS: Final = ("host", "cortex-m")


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "new-controller",
        help="write a project for a controller of your own, which drives as written",
        description="Write a project for a controller of your own: the frames as code generated "
        "from the DBC files, a client of the bench, a controller that drives to the next station "
        "and opens the doors, a Makefile and a job for continuous integration.",
    )
    parser.add_argument("folder", metavar="FOLDER", help="new folder; its name is the program's")
    parser.add_argument(
        "--lang", choices=LANGUAGES, default="c", help="language of the project; default: c"
    )
    parser.add_argument(
        "--target",
        choices=TARGETS,
        default="host",
        help="where the program runs: on this machine, or as firmware on a Cortex-M3 that QEMU "
        "emulates (with --lang c); default: host",
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Raises UsageError, and writes nothing, for a folder that exists or has no usable name."""
    from metro_hil.engine.errors import UsageError
    from metro_hil.external_controller.project import project_files

    folder = Path(options.folder)
    name = folder.resolve().name
    if not NAME.fullmatch(name):
        raise UsageError(
            f"{options.folder}: {name!r} is no name of a program; use letters, digits, _ and -, "
            "and begin with a letter"
        )
    if options.target != "host" and options.lang != "c":
        raise UsageError(f"--target {options.target}: needs --lang c, not {options.lang}")
    if folder.exists():
        raise UsageError(f"{options.folder}: exists; name a new folder")
    files = project_files(name, options.lang, options.target)
    for path, text in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    print(f"wrote {len(files)} files to {folder}")
    print(f"next: cd {folder} && make test")
    return EXIT_OK
