"""Creates the pictures of the documents, each from a run, or checks that they match the present
code.

`docs/images/pictures.toml` has the commands of each picture. A picture is created again when its
run gives other frames than before; `frames.json` beside it stores the hashes of the frames.
"""

import argparse
import hashlib
import json
import shlex
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from metro_tools.browser import Browser, browser_path

IMAGES: Final = "docs/images"
RECIPES: Final = "pictures.toml"
FRAMES: Final = "frames.json"
KEYS: Final = frozenset({"probe", "log", "commands", "picture", "page", "width", "height"})
EXIT_OK: Final = 0
EXIT_OUTDATED: Final = 1
EXIT_USAGE: Final = 2
EXIT_ENVIRONMENT: Final = 3


class PictureError(Exception):
    """A picture cannot be created; the text says which and why."""


def read_recipes(images: Path) -> dict[str, Mapping[str, Any]]:
    """Read the recipes by the name of the picture's file. Raises PictureError."""
    path = images / RECIPES
    try:
        recipes = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise PictureError(f"{path}: {error}") from error
    for name, recipe in recipes.items():
        unknown = sorted({*recipe} - KEYS)
        if unknown:
            raise PictureError(f"{path}: {name}: unknown key {unknown[0]}")
        if not {"probe", "log"} <= {*recipe} or ("picture" in recipe) == ("page" in recipe):
            raise PictureError(f"{path}: {name}: needs probe, log, and either picture or page")
    return recipes


def read_frames(images: Path) -> dict[str, str]:
    """Read the hash of the frames of each picture; empty if none is stored."""
    path = images / FRAMES
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else {}


def main(argv: Sequence[str] | None = None) -> int:
    """Create the outdated pictures, or with --check only report them."""
    parser = argparse.ArgumentParser(prog="python -m metro_tools.picture_doc", description=__doc__)
    parser.add_argument("picture", nargs="*", help="names without suffix; default: all")
    parser.add_argument("--root", default=".", help="the project's folder; default: here")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if outdated")
    options = parser.parse_args(argv)
    images = Path(options.root) / IMAGES
    try:
        recipes = read_recipes(images)
        unknown = [name for name in options.picture if name not in recipes]
        if unknown:
            raise PictureError(f"{unknown[0]}: not in {images / RECIPES}")
        chosen = {name: recipes[name] for name in options.picture or recipes}
        outdated = list(_outdated(images, chosen))
        if options.check:
            for name, _ in outdated:
                shown = images / file_name(name, recipes[name])
                words = f"{shown} shows frames of older code; run `make docs`"
                print(words, file=sys.stderr)
            return EXIT_OUTDATED if outdated else EXIT_OK
        for name, frames in outdated:
            _make(images, name, recipes[name])
            kept = read_frames(images) | {name: frames}
            text = json.dumps(kept, indent=1, sort_keys=True) + "\n"
            (images / FRAMES).write_text(text, encoding="utf-8")
            print(f"{images / file_name(name, recipes[name])}: made again")
    except PictureError as error:
        print(f"picture_doc: {error}", file=sys.stderr)
        return EXIT_ENVIRONMENT
    return EXIT_OK


def _outdated(images: Path, recipes: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    """Yield the names of outdated pictures, each with the hash of the present frames."""
    kept = read_frames(images)
    found: dict[tuple[str, str], str] = {}
    for name, recipe in recipes.items():
        probe = (recipe["probe"], recipe["log"])
        if probe not in found:
            with tempfile.TemporaryDirectory(prefix="pictures-") as scratch:
                _run(name, [recipe["probe"]], Path(scratch))
                log = _only(name, Path(scratch), recipe["log"])
                found[probe] = hashlib.sha256(log.read_bytes()).hexdigest()
        if kept.get(name) != found[probe] or not (images / file_name(name, recipe)).is_file():
            yield name, found[probe]


def file_name(name: str, recipe: Mapping[str, Any]) -> str:
    """The picture's file below docs/images: what its commands leave, or a screenshot of a page."""
    return name + Path(recipe.get("picture", "page.png")).suffix


def _make(images: Path, name: str, recipe: Mapping[str, Any]) -> None:
    with tempfile.TemporaryDirectory(prefix="pictures-") as scratch:
        place = Path(scratch)
        _run(name, [recipe["probe"], *recipe.get("commands", ())], place)
        target = images / file_name(name, recipe)
        if "picture" in recipe:
            shutil.copy(_only(name, place, recipe["picture"]), target)
            return
        page = _only(name, place, recipe["page"])
        if browser_path() is None:
            raise PictureError(
                f"{name}: a picture of a page needs Chromium, which is not installed"
            )
        with Browser(width=recipe["width"], height=recipe["height"]) as browser:
            browser.open(page.as_uri(), ready="document.readyState === 'complete'")
            browser.settle()
            browser.screenshot(target)


def _run(name: str, commands: Sequence[str], place: Path) -> None:
    """Run each command with the programs of the present environment. Raises PictureError."""
    programs = Path(sys.executable).parent
    for command in commands:
        words = shlex.split(command)
        done = subprocess.run(  # noqa: S603
            [str(programs / words[0]), *words[1:]],
            cwd=place,
            capture_output=True,
            text=True,
            check=False,
        )
        # A failed monitor gives 1; its picture is still useful.
        if done.returncode not in (0, 1):
            last = (done.stderr or done.stdout).strip().splitlines()[-1:]
            raise PictureError(f"{name}: {command}: status {done.returncode}: {' '.join(last)}")


def _only(name: str, place: Path, pattern: str) -> Path:
    found = sorted(place.glob(pattern))
    if not found:
        raise PictureError(f"{name}: its commands create no {pattern}")
    return found[0]


if __name__ == "__main__":
    sys.exit(main())
