"""Builds the documentation site: `python -m metro_tools.site` (`make site`).

The documents are read on a code host, too. So the site is built from a copy of docs/ in which links
to sources, which the site does not have, are plain text. `docs/nav.toml` is the table of contents.
Sphinx builds with every warning as an error. `fetch` takes the library that draws charts from the
npm registry, once; after that neither building nor reading needs a network.
"""

import argparse
import base64
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.storage.whole_file import write_whole

DOCS: Final = "docs"
NAVIGATION: Final = "docs/nav.toml"
HOME: Final = "docs/README.md"
OUTPUT: Final = "site"
MADE_BY_SPHINX: Final = ".buildinfo"
PROJECT: Final = "project"
"""Folder of the site with the documents that lie beside docs/."""
PROJECT_PAGES: Final = ("CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md")
PACKAGE: Final = "mermaid@11.12.0"
SHA512: Final = (
    "ZudVx73BwrMJfCFmSSJT84y6u5brEoV8DOItdHomNLz32uBjNrelm7mg95X7g+C6UoQH/W6mBLGDEDv73JdxBg=="
)
"""Of the package's tarball, in the registry's form."""
MEMBER: Final = "package/dist/mermaid.min.js"
SCRIPT: Final = Path(sys.prefix) / "share" / "metro-bench" / "mermaid.min.js"
"""Where the environment keeps the library."""
LINK: Final = re.compile(r"(!?)\[([^\[\]]*)\]\(([^()\s#]*)(#[^()\s]*)?\)")
FENCE: Final = re.compile(r"^\s*(`{3,}|~{3,})")
HEADING: Final = re.compile(r"^(#{1,6})\s+(.*?)\s*$")
EXIT_OK: Final = 0
EXIT_FAILED: Final = 1
EXIT_ENVIRONMENT: Final = 3


class SiteError(Exception):
    """Something that the site needs is missing; the text says what to do."""


class SiteSection(NamedTuple):
    """One part of the table of contents."""

    title: str
    pages: tuple[str, ...]
    """Relative to docs/, or names of PROJECT_PAGES."""


class PageLink(NamedTuple):
    """A relative link of a document."""

    line: int
    target: str
    """Path as it stands in the document; empty for the document itself."""
    anchor: str


def navigation(root: Path) -> list[SiteSection]:
    """The table of contents, in order. Raises SiteError."""
    try:
        table = tomllib.loads((root / NAVIGATION).read_text(encoding="utf-8"))
        return [SiteSection(each["title"], tuple(each["pages"])) for each in table["section"]]
    except (OSError, ValueError, KeyError) as error:
        raise SiteError(f"{NAVIGATION}: {error}; write [[section]] with title and pages") from error


def outside_fences(text: str) -> Iterator[tuple[int, str]]:
    """Lines that are no code, by number."""
    fence = ""
    for number, line in enumerate(text.splitlines(), start=1):
        found = FENCE.match(line)
        if found and not fence:
            fence = found[1]
        elif found and found[1].startswith(fence) and not line.strip().strip("`~"):
            fence = ""
        elif not fence:
            yield number, line


def links_of(text: str) -> Iterator[PageLink]:
    """All links and pictures whose target lies in the project."""
    for number, line in outside_fences(text):
        for found in LINK.finditer(re.sub(r"`[^`]*`", "", line)):
            if "://" not in found[3] and not found[3].startswith("mailto:"):
                yield PageLink(number, found[3], (found[4] or "").removeprefix("#"))


def anchors_of(text: str) -> set[str]:
    """Names of a document's headings, as code hosts and the site make them."""
    anchors: set[str] = set()
    for _, line in outside_fences(text):
        if found := HEADING.match(line):
            words = re.sub(r"\[([^\[\]]*)\]\([^()]*\)", r"\1", found[2])
            base = re.sub(r"[^\w\- ]", "", words.lower()).replace(" ", "-")
            name, count = base, 0
            while name in anchors:
                count += 1
                name = f"{base}-{count}"
            anchors.add(name)
    return anchors


def stage(root: Path, target: Path) -> None:
    """Copy the documents to `target` as the site shows them."""
    shutil.copytree(root / DOCS, target)
    for name in PROJECT_PAGES:
        (target / PROJECT).mkdir(exist_ok=True)
        text = (root / name).read_text(encoding="utf-8")
        path = target / PROJECT / name.lower()
        path.write_text(_mended(text, root, Path(), Path(PROJECT)), encoding="utf-8")
    for path in sorted(target.rglob("*.md")):
        folder = path.relative_to(target).parent
        if folder.parts[:1] != (PROJECT,):
            text = path.read_text(encoding="utf-8")
            path.write_text(_mended(text, root, Path(DOCS) / folder, folder), encoding="utf-8")
    home = target / Path(HOME).name
    contents = "\n".join(_contents(section) for section in navigation(root))
    (target / "index.md").write_text(f"{home.read_text(encoding='utf-8')}\n{contents}")
    home.unlink()


def _contents(section: SiteSection) -> str:
    pages = [
        f"{PROJECT}/{page.lower()}" if page in PROJECT_PAGES else page for page in section.pages
    ]
    lines = ["```{toctree}", ":hidden:", f":caption: {section.title}", ":maxdepth: 1", *pages]
    return "\n".join([*lines, "```\n"])


def _mended(text: str, root: Path, folder: Path, page_folder: Path) -> str:
    """The text with links as they are in the site.

    Args:
        folder: of the document below `root`.
        page_folder: of its page in the site.
    """

    def mend(found: "re.Match[str]") -> str:
        picture, words, target, anchor = found.groups()
        if not target or "://" in target or target.startswith("mailto:"):
            return found.group()
        place = Path(os.path.normpath(folder / target))
        page = _page_of(place)
        if page is None:
            return words if (root / place).exists() else found.group()
        moved = Path(os.path.relpath(page, page_folder)).as_posix()
        return f"{picture}[{words}]({moved}{anchor or ''})"

    lines = text.splitlines()
    for number, line in outside_fences(text):
        lines[number - 1] = LINK.sub(mend, line)
    return "\n".join(lines) + "\n"


def _page_of(place: Path) -> Path | None:
    """Where the site has a file of the project; None where it has none."""
    if place.as_posix() in (HOME, "README.md"):
        return Path("index.md")
    if place.as_posix() in PROJECT_PAGES:
        return Path(PROJECT) / place.name.lower()
    return place.relative_to(DOCS) if place.is_relative_to(DOCS) else None


def build(root: Path, output: Path) -> int:
    """Sphinx's exit status; it stops for no warning, prints all, and fails for any."""
    if not SCRIPT.is_file():
        raise SiteError(f"{SCRIPT} is missing; `python -m metro_tools.site fetch` gets it once")
    if output.is_dir() and any(output.iterdir()):
        if not (output / MADE_BY_SPHINX).is_file():
            raise SiteError(f"{output}: not empty, and no site of an earlier build; remove it")
        shutil.rmtree(output)
    with tempfile.TemporaryDirectory(prefix="site-") as scratch:
        source = Path(scratch) / "source"
        stage(root, source)
        options = ["-W", "--keep-going", "--quiet", "-c", str(root / DOCS), "-j", "auto"]
        words = [sys.executable, "-m", "sphinx", *options, "-b", "html", str(source), str(output)]
        return subprocess.run(words, check=False).returncode  # noqa: S603


def fetch() -> None:
    """Put the library into this environment unless it is there. Raises SiteError."""
    if SCRIPT.is_file():
        return
    npm = shutil.which("npm")
    if npm is None:
        raise SiteError(
            "npm is missing; install it (Debian: apt-get install npm), or copy mermaid.min.js of "
            f"{PACKAGE} to {SCRIPT}"
        )
    with tempfile.TemporaryDirectory(prefix="mermaid-") as scratch:
        done = subprocess.run(  # noqa: S603
            [npm, "pack", "--silent", PACKAGE],
            cwd=scratch,
            capture_output=True,
            text=True,
            check=False,
        )
        tarballs = sorted(Path(scratch).glob("*.tgz"))
        if done.returncode or not tarballs:
            last = (done.stderr.strip().splitlines() or ["no tarball came"])[-1]
            raise SiteError(f"npm pack {PACKAGE}: {last}")
        SCRIPT.parent.mkdir(parents=True, exist_ok=True)
        write_whole(SCRIPT, member_of(tarballs[0]))


def member_of(tarball: Path) -> bytes:
    """The library out of the package. Raises SiteError for any other tarball than the pinned."""
    digest = base64.b64encode(hashlib.sha512(tarball.read_bytes()).digest()).decode()
    if digest != SHA512:
        raise SiteError(f"{tarball.name}: sha512 {digest} is not that of {PACKAGE}; do not use it")
    with tarfile.open(tarball) as package:
        found = package.extractfile(MEMBER)
        assert found is not None
        return found.read()


def main(argv: Sequence[str] | None = None) -> int:
    """Exit code 1 when Sphinx finds a fault, 3 when something is missing."""
    parser = argparse.ArgumentParser(prog="python -m metro_tools.site", description=__doc__)
    parser.add_argument("verb", nargs="?", choices=("build", "fetch"), default="build")
    parser.add_argument("--out", type=Path, default=Path(OUTPUT), help="default: %(default)s")
    options = parser.parse_args(argv)
    try:
        if options.verb == "fetch":
            fetch()
            return EXIT_OK
        if build(Path(), options.out):
            return EXIT_FAILED
    except (SiteError, OSError) as error:
        print(f"site: {error}", file=sys.stderr)
        return EXIT_ENVIRONMENT
    print(f"site: {options.out / 'index.html'}")
    return EXIT_OK


if __name__ == "__main__":
    sys.exit(main())
