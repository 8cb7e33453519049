"""`hil new-controller`: a small project for a controller of one's own, which drives as written."""

import argparse
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Final

from metro_hil.model.run_options import EXIT_OK

KITS: Final = "metro_hil.cli"
NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
COMMON: Final = {
    "common/bench.yml": ".github/workflows/bench.yml",
    "common/gitignore": ".gitignore",
}
LIBRARY: Final = ("lockstep.h", "lockstep.c", "tags.h", "tags.c", "radio.h", "radio.c")
"""Files in C of the projects in C and in C++."""
OWN: Final = ("controller", "main")
"""Sources that are in the language of the project."""


@dataclass(frozen=True, slots=True)
class Language:
    """A language that a project can be written in."""

    title: str
    suffix: str
    link: str
    """Variable of the Makefile with the program that links."""


LANGUAGES: Final[Mapping[str, Language]] = {
    "c": Language("C", "c", "CC"),
    "cpp": Language("C++", "cpp", "CXX"),
}


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
        "--lang", choices=list(LANGUAGES), default="c", help="language of the project; default: c"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Raises UsageError, and writes nothing, for a folder that exists or has no usable name."""
    from metro_hil.engine.errors import UsageError

    folder = Path(options.folder)
    name = folder.resolve().name
    if not NAME.fullmatch(name):
        raise UsageError(
            f"{options.folder}: {name!r} is no name of a program; use letters, digits, _ and -, "
            "and begin with a letter"
        )
    if folder.exists():
        raise UsageError(f"{options.folder}: exists; name a new folder")
    files = project_files(name, options.lang)
    for path, text in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    print(f"wrote {len(files)} files to {folder}")
    print(f"next: cd {folder} && make test")
    return EXIT_OK


def project_files(name: str, lang: str) -> dict[str, str]:
    """The text of each file of a project by its path."""
    from can_dbc import c_source

    language = LANGUAGES[lang]
    sources = [f"{own}.{language.suffix}" for own in OWN]
    sources += ["wire.c", *(file for file in LIBRARY if file.endswith(".c"))]
    words = {
        "name": name,
        "language": language.title,
        "suffix": language.suffix,
        "link": language.link,
        "sources": " ".join(sources),
    }
    files = {to: _template(source) for source, to in COMMON.items()}
    files |= {file: _template(f"c/{file}") for file in ("Makefile", "README.md", *LIBRARY)}
    # C++ takes the same text as C.
    files |= {f"{own}.{language.suffix}": _template(f"c/{own}.c") for own in OWN}
    files["controller.h"] = _template("c/controller.h")
    filled = {path: _filled(text, words) for path, text in files.items()}
    return {**filled, **c_source.wire_files(c_source.shipped_bindings())}


def _template(name: str) -> str:
    return (resources.files(KITS) / "kits" / name).read_text(encoding="utf-8")


def _filled(text: str, words: Mapping[str, str]) -> str:
    for word, value in words.items():
        text = text.replace(f"@{word}@", value)
    return text
