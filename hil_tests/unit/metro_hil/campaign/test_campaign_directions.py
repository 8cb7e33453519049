"""A campaign runs a line of its own in the other direction."""

from pathlib import Path
from typing import Final

import pytest

from metro_hil.campaign.sources import Sources
from metro_hil.model.case_setup import file_name

HARBOUR: Final = Path(__file__).resolve().parents[4] / "docs" / "examples" / "line" / "harbour.toml"


@pytest.mark.parametrize("route", ["up", "down"])
def test_a_route_of_the_users_line_keeps_the_file_that_it_is_of(tmp_path: Path, route: str) -> None:
    text = HARBOUR.read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    sources = Sources(tmp_path)

    name, line = sources.line(f"mine.toml:{route}")

    assert name == f"mine.toml:{route}"
    assert sources.files == {"mine.toml": text}
    assert line.stations[0].name == {"up": "Quay", "down": "Castle"}[route]
    assert file_name(name, sources.paths) == f"{tmp_path / 'mine.toml'}:{route}"


def test_a_route_of_a_shipped_line_is_no_file(tmp_path: Path) -> None:
    sources = Sources(tmp_path)

    name, line = sources.line("florence:down")

    assert (name, line.name) == ("florence:down", "florence-down")
    assert sources.files == {}
