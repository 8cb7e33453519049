"""The documentation: its table of contents is complete, every link resolves, generated pages hold.

Nothing is built here. `make site` builds the site and takes every warning for an error.
"""

import os
from collections import Counter
from pathlib import Path
from typing import Final

import pytest

from metro_tools import api_doc, command_doc, key_doc, site

ROOT: Final = Path(__file__).resolve().parents[2]
PAGES: Final = sorted(
    path.relative_to(ROOT).as_posix()
    for path in (ROOT / site.DOCS).rglob("*.md")
    if "runs" not in path.parts
)
DOCUMENTS: Final = ["README.md", *site.PROJECT_PAGES, *PAGES]
README_LINES_MAX: Final = 120


def test_the_table_of_contents_names_every_page_once() -> None:
    """When this fails, put the page into docs/nav.toml."""
    named = [page for section in site.navigation(ROOT) for page in section.pages]
    wanted = [page.removeprefix("docs/") for page in PAGES if page != site.HOME]

    assert sorted(named) == sorted([*wanted, *site.PROJECT_PAGES])


def faults_of(root: Path, name: str) -> list[str]:
    """Links of one document that lead nowhere."""
    text = (root / name).read_text(encoding="utf-8")
    faults = []
    for link in site.links_of(text):
        target = Path(os.path.normpath((root / name).parent / link.target))
        if not link.target:
            target = root / name
        where = f"{name}:{link.line}: {link.target}#{link.anchor}"
        if not target.exists():
            faults.append(f"{where}: no such file")
        elif link.anchor and target.suffix == ".md":
            known = site.anchors_of(target.read_text(encoding="utf-8"))
            faults += [] if link.anchor in known else [f"{where}: no such heading"]
    return faults


def test_every_link_of_the_documents_resolves() -> None:
    assert [fault for name in DOCUMENTS for fault in faults_of(ROOT, name)] == []


def test_a_wrong_link_would_be_found(tmp_path: Path) -> None:
    (tmp_path / "a.md").write_text(
        "# One & two\n\n[no](b.md) [no](#one) [yes](#one--two) [yes](https://x.y/z.md)\n"
        "`[code](c.md)` ![no](p.png)\n\n```\n[code](d.md)\n```\n",
        encoding="utf-8",
    )

    faults = faults_of(tmp_path, "a.md")

    assert [fault.split(": ")[1] for fault in faults] == ["b.md#", "#one", "p.png#"]


def test_the_readme_fits_on_a_screen_and_a_half() -> None:
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()

    assert len(lines) <= README_LINES_MAX


def test_a_release_has_at_most_120_bullets() -> None:
    sections = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").split("\n## ")[1:]
    bullets = Counter({section.split()[0]: section.count("\n- ") for section in sections})

    assert [version for version, count in bullets.items() if count > 120] == []


def test_every_key_of_a_file_has_a_meaning() -> None:
    """When this fails, give the field a docstring, or key_meanings.toml a line."""
    assert key_doc.without_meaning() == []


@pytest.mark.parametrize(
    "generator", [key_doc, command_doc, api_doc], ids=lambda each: each.__name__
)
def test_generated_pages_are_those_of_the_code(
    generator: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    """When this fails, run `make docs`."""
    monkeypatch.chdir(ROOT)

    assert generator.main(["--check"]) == 0  # type: ignore[attr-defined]


def test_a_staged_page_has_links_of_the_site(tmp_path: Path) -> None:
    target = tmp_path / "source"

    site.stage(ROOT, target)

    law = (target / "guide" / "my_law.md").read_text(encoding="utf-8")
    contributing = (target / "project" / "contributing.md").read_text(encoding="utf-8")
    home = (target / "index.md").read_text(encoding="utf-8")
    assert "](../../vobc" not in law
    assert "in law.py:" in law
    assert "](../design/development.md)" in contributing
    assert "](project/changelog.md)" in home
    assert "guide/tutorial.md" in home
    assert not (target / "README.md").exists()
