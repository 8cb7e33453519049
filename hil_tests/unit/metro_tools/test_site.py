"""What the documentation site is made of, without building it."""

from pathlib import Path

import pytest

from metro_tools import site


def test_headings_become_anchors_as_on_code_hosts() -> None:
    text = "# A `b` & [c](d.md)!\n\n## Twice\n\n## Twice\n\n```\n# no heading\n```\n"

    assert site.anchors_of(text) == {"a-b--c", "twice", "twice-1"}


def test_links_in_code_are_no_links() -> None:
    text = "[a](b.md#c) `[x](y.md)`\n\n```sh\n[d](e.md)\n```\n![p](q.png) [w](https://h.i)\n"

    assert list(site.links_of(text)) == [
        site.PageLink(1, "b.md", "c"),
        site.PageLink(6, "q.png", ""),
    ]


def test_any_other_tarball_than_the_pinned_is_refused(tmp_path: Path) -> None:
    tarball = tmp_path / "mermaid.tgz"
    tarball.write_bytes(b"another")

    with pytest.raises(site.SiteError, match=r"mermaid\.tgz: sha512 .* is not that of mermaid@"):
        site.member_of(tarball)


@pytest.mark.parametrize("text", ["", "[[section]]\ntitle = 'x'\n", "[[section"])
def test_a_wrong_table_of_contents_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / site.NAVIGATION
    path.parent.mkdir()
    path.write_text(text, encoding="utf-8")

    with pytest.raises(site.SiteError, match=r"docs/nav\.toml: "):
        site.navigation(tmp_path)


def test_a_folder_that_is_no_site_is_never_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = tmp_path / "mine" / "work.txt"
    kept.parent.mkdir()
    kept.write_text("mine", encoding="utf-8")
    monkeypatch.setattr(site, "SCRIPT", kept)

    with pytest.raises(site.SiteError, match="not empty"):
        site.build(tmp_path, kept.parent)

    assert kept.read_text(encoding="utf-8") == "mine"
