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
    """A language whose projects use the library in C."""

    title: str
    suffix: str
    link: str
    """Variable of the Makefile with the program that links."""


COMPILED: Final[Mapping[str, Language]] = {
    "c": Language("C", "c", "CC"),
    "cpp": Language("C++", "cpp", "CXX"),
}
PYTHON: Final = "python"
PYTHON_FILES: Final = ("controller.py", "main.py", "radio.py", "tags.py")
LANGUAGES: Final = (*COMPILED, PYTHON)


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
    from can_dbc import c_source, python_source

    files = {to: _template(source) for source, to in COMMON.items()}
    bound = c_source.shipped_bindings()
    if lang == PYTHON:
        files |= {file: _template(f"{PYTHON}/{file}.in") for file in PYTHON_FILES}
        files |= {file: _template(f"{PYTHON}/{file}") for file in ("Makefile", "README.md")}
        words, wire = {"name": name}, python_source.wire_files(bound)
    else:
        files |= _c_templates(COMPILED[lang].suffix)
        words, wire = _c_words(name, COMPILED[lang]), c_source.wire_files(bound)
    return {**{path: _filled(text, words) for path, text in files.items()}, **wire}


def _c_templates(suffix: str) -> dict[str, str]:
    """The files of a project in C. In C++ the controller has the same text."""
    same = ("Makefile", "README.md", "controller.h", *LIBRARY)
    own = {f"{stem}.{suffix}": _template(f"c/{stem}.c") for stem in OWN}
    return {**{file: _template(f"c/{file}") for file in same}, **own}


def _c_words(name: str, language: Language) -> dict[str, str]:
    sources = [f"{stem}.{language.suffix}" for stem in OWN]
    sources += ["wire.c", *(file for file in LIBRARY if file.endswith(".c"))]
    return {
        "name": name,
        "language": language.title,
        "suffix": language.suffix,
        "link": language.link,
        "sources": " ".join(sources),
    }


def _template(name: str) -> str:
    return (resources.files(KITS) / "kits" / name).read_text(encoding="utf-8")


def _filled(text: str, words: Mapping[str, str]) -> str:
    for word, value in words.items():
        text = text.replace(f"@{word}@", value)
    return text
