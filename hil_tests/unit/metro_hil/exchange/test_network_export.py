"""A network that is exported and imported again is the same network."""

from pathlib import Path
from typing import Final

import pytest

from firmware_py.trackdb.circuit import load_network
from firmware_py.trackdb.network import Running
from metro_hil.attack.networks import write_networks
from metro_hil.exchange import export_command, import_command

JUNCTION: Final = Path(__file__).resolve().parents[4] / "docs/examples/line/junction.toml"
SEED: Final = 18
"""Seed of a drawn network of two tracks without a switch."""


def there_and_back(source: Path, folder: Path, *changes: tuple[str, str]) -> Path:
    """The file of an import of an export, whose text was changed in between."""
    path = folder / "net.railml"
    assert export_command.main([str(source), "--as", "railml", "--out", str(path), "--force"]) == 0
    text = path.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text, encoding="utf-8")
    assert import_command.main([str(path), "--out", str(folder / "back"), "--force"]) == 0
    (found,) = (folder / "back").glob("*.toml")
    return found


def test_a_network_comes_back(tmp_path: Path) -> None:
    write_networks(tmp_path, SEED, 1)
    for number, source in enumerate((JUNCTION, *(tmp_path / "lines").glob("net*.toml"))):
        folder = tmp_path / str(number)
        folder.mkdir()

        assert load_network(str(there_and_back(source, folder))) == load_network(str(source))


def test_the_elements_alone_have_tracks_switches_limits_and_gradients(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Another program has lowered the speed of a branch, so the table no longer counts."""
    change = ('branchingSpeed="57.6"', 'branchingSpeed="36"')

    back = load_network(str(there_and_back(JUNCTION, tmp_path, change)))

    assert "elements were changed since the export" in capsys.readouterr().out
    own = load_network(str(JUNCTION))
    assert back.switches == own.switches
    assert set(back.buffer_stops) == set(own.buffer_stops)
    for track in own.tracks:
        other = back.track(track.name)
        assert (other.start_m, other.end_m) == (track.start_m, track.end_m)
        assert other.gradients == track.gradients
        assert [(e.station, e.start_m, e.end_m, e.side) for e in other.platforms] == [
            (e.station, e.start_m, e.end_m, e.side) for e in track.platforms
        ]
    assert back.track("pier").limits == own.track("pier").limits
    # A train that branches to the left runs down the west track, over its last 30 m.
    (*_, before, last) = back.track("west").limits_for(Running.DOWN)
    assert (last.start_m, last.end_m, before.limit_mps) == (820.0, 850.0, 16.0)
    assert last.limit_mps * 3.6 == pytest.approx(36.0)
    assert [limit.limit_mps for limit in back.track("west").limits_for(Running.UP)] == [16.0]
