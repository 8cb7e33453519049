"""The files of a project for a controller of one's own, made from `kits/` and the DBC files."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Final

from can_dbc import c_source, python_source, rust_source

KITS: Final = "metro_hil.external_controller"
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
HOST: Final = "host"
CORTEX_M: Final = "cortex-m"
BOARD_FILES: Final = ("Makefile", "board.c", "board.ld", "board.sh")
"""Files of a project in C that runs on a Cortex-M without an operating system."""
BOARD_TOOLS: Final = """
      - run: sudo apt-get update
      - run: sudo apt-get install -y gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"""
PYTHON: Final = "python"
PYTHON_FILES: Final = ("controller.py", "main.py", "radio.py", "tags.py")
RUST: Final = "rust"
RUST_FILES: Final = ("controller.rs", "lockstep.rs", "main.rs", "radio.rs", "tags.rs")


def project_files(name: str, lang: str, target: str = HOST) -> dict[str, str]:
    """The text of each file of a project by its path. Only projects in C have other targets."""
    files = {to: _template(source) for source, to in COMMON.items()}
    bound = c_source.shipped_bindings()
    if lang == PYTHON:
        files |= {file: _template(f"{PYTHON}/{file}.in") for file in PYTHON_FILES}
        files |= {file: _template(f"{PYTHON}/{file}") for file in ("Makefile", "README.md")}
        words, wire = {"name": name}, python_source.wire_files(bound)
    elif lang == RUST:
        same = ("Cargo.toml", "Makefile", "README.md")
        files |= {file: _template(f"{RUST}/{file}") for file in same}
        files |= {f"src/{file}": _template(f"{RUST}/{file}") for file in RUST_FILES}
        words = {"name": name}
        wire = {f"src/{file}": text for file, text in rust_source.wire_files(bound).items()}
    else:
        files |= _c_templates(COMPILED[lang].suffix)
        words, wire = _c_words(name, COMPILED[lang]), c_source.wire_files(bound)
    words["tools"] = ""
    if target == CORTEX_M:
        files |= {file: _template(f"cortex_m/{file}") for file in BOARD_FILES}
        files["README.md"] += _template("cortex_m/README.md")
        words["tools"] = BOARD_TOOLS
    return {**{path: _filled(text, words) for path, text in files.items()}, **wire}


def _c_templates(suffix: str) -> dict[str, str]:
    """The files of a project in C. In C++ the controller has the same text."""
    same = ("Makefile", "README.md", "controller.h", *LIBRARY)
    own = {f"{stem}.{suffix}": _template(f"c/{stem}.c") for stem in OWN}
    if suffix != "c":
        # C99 has no empty initializer, and compilers of C++ warn of the one that C needs.
        own = {name: text.replace(" = {0};", " = {};") for name, text in own.items()}
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
