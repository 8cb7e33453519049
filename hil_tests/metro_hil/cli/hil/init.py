"""`hil init`: a folder to start from, with a line, a train, scenarios and a controller."""

import argparse
from importlib import resources
from pathlib import Path
from typing import Final

from metro_hil.model.run_options import EXIT_OK

SKELETON: Final = "metro_hil.cli.skeleton"
WRITTEN: Final = ("scenario.toml", "line.toml", "controller.toml", "controller.py")
"""Files that are written as they ship."""
SOURCE: Final = "florence4"
"""Shipped train that train.toml and params.toml are copies of."""
TRAIN_HEAD: Final = """\
# The real train of the emulator: a copy of the shipped consist florence4. `vobc consists` lists the
# others, `vobc show consist NAME` prints one. A range low..high is sampled once for each seed.

"""
PARAMS_HEAD: Final = """\
# What the controller assumes of its train: a copy of the shipped parameters florence4. A train that
# is not as assumed is a test: change train.toml alone, or [train.real] of a scenario.

"""


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "init",
        help="write a scenario, a line, a train and a controller to start from",
        description="Write commented files to start from: scenario.toml with line.toml, train.toml "
        "and params.toml, and a controller in Python with controller.toml. They run as written.",
    )
    parser.add_argument(
        "folder", nargs="?", default=".", metavar="FOLDER", help="default: this folder"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Raises UsageError, and writes nothing, if one of the files exists."""
    from metro_hil.engine.errors import UsageError

    folder = Path(options.folder)
    files = skeleton_files()
    for name in files:
        if (folder / name).exists():
            raise UsageError(f"{folder / name}: exists; name a folder without it")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise UsageError(f"{folder}: is not a folder") from error
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
        print(f"wrote {folder / name}")
    there = "" if folder == Path() else f"cd {folder} && "
    print(f"next: {there}hil run scenario.toml; then hil run controller.toml")
    return EXIT_OK


def skeleton_files() -> dict[str, str]:
    """The text of each file by its name."""
    from firmware_py.settings import find, text_of
    from plant_emulator.train_config import PACKAGE
    from vobc.config import SHIPPED

    ship = resources.files(SKELETON)
    files = {name: (ship / name).read_text(encoding="utf-8") for name in WRITTEN}
    for name, head, package in (
        ("train.toml", TRAIN_HEAD, PACKAGE),
        ("params.toml", PARAMS_HEAD, SHIPPED),
    ):
        text = text_of(find(SOURCE, package))
        files[name] = head + text.replace(f'name = "{SOURCE}"', 'name = "mine"', 1)
    return files
