"""Networks by chance: what they hold, that a seed repeats them, and that their services fit."""

import itertools
from pathlib import Path

import pytest

from firmware_py.trackdb.circuit import load_network
from metro_hil.attack.networks import write_networks
from metro_hil.campaign import plan_cases, read_campaign
from metro_hil.cli.hil import main
from metro_hil.model.service import load_service
from metro_hil.run.turnback import changes_ends


def test_a_seed_repeats_a_network_wherever_it_is_in_the_campaign(tmp_path: Path) -> None:
    many = write_networks(tmp_path / "many", 6, 2)
    one = write_networks(tmp_path / "one", 7, 1)

    cases = {case.id: case for case in plan_cases(read_campaign(str(many)))}
    (alone,) = plan_cases(read_campaign(str(one)))

    assert (cases[alone.id].setup, cases[alone.id].faults) == (alone.setup, alone.faults)
    for name in ("lines/net7.toml", "lines/service7.toml"):
        assert (one.parent / name).read_bytes() == (many.parent / name).read_bytes()


def test_networks_have_switches_crossovers_sidings_and_loops_and_services_fit(
    tmp_path: Path,
) -> None:
    """A service that does not fit its network, train or parameters would not be planned."""
    write_networks(tmp_path, 1, 16)

    networks = [load_network(str(path)) for path in (tmp_path / "lines").glob("net*.toml")]
    names = {track.name[0] for network in networks for track in network.tracks}
    sides = {edge.side.name for net in networks for t in net.tracks for edge in t.platforms}
    ways = set()
    for path in (tmp_path / "lines").glob("service*.toml"):
        trips = load_service(str(path))
        for came, leaves in itertools.pairwise(trips):
            place = came.path.to_track(came.path.line.station(came.end).stop_m)
            ways.add(changes_ends(leaves.path, place))

    assert names == {"s", "e", "w", "x", "l"}
    assert sides == {"RIGHT", "NONE"}
    assert ways == {True, False}
    assert {route.name for network in networks for route in network.routes} > {"r0", "r1", "r4"}
    assert max(len(network.switches) for network in networks) > 10
    assert all(len(network.tracks) <= 30 for network in networks)
    assert all(len(network.switches) <= 15 for network in networks)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--networks", "2"], "--networks 2: makes a campaign of its own; add --runs 0"),
        (
            ["--networks", "2", "--runs", "0", "--controller", "command:x"],
            "--networks 2: needs the shipped controller",
        ),
    ],
)
def test_what_does_not_go_with_networks_is_refused(
    words: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["attack", *words]) == 2

    assert text in capsys.readouterr().err
