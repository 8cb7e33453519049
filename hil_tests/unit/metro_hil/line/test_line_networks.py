"""The treatment of packets by the program between networks follows from the seed, and is
counted."""

import argparse
import itertools

import pytest

from metro_hil.cli.hil import main
from metro_hil.line.network.namespaces import destination_of
from metro_hil.line.network.options import OwnNetworks, add_options, networks_of
from metro_hil.line.network.packet_faults import Ether, Way
from metro_hil.line.network.packet_process import ways_of
from metro_hil.simulation.links import Weather

MS = 1_000_000
OUT, BACK = ("T1", "wayside"), ("wayside", "T1")
FOUL = Weather(delay_ns=5 * MS, spread_ns=10 * MS, loss_share=0.2, double_share=0.1)


def arrivals(ether: Ether, way: Way, packets: int) -> list[tuple[int, bytes]]:
    """Send one packet each millisecond; return what arrives when."""
    arrived = []
    for now_ms in range(packets + 100):
        if now_ms < packets:
            ether.send(now_ms * MS, way, b"%d" % now_ms)
        arrived += [(now_ms, packet) for _, packet in ether.take(now_ms * MS)]
    return arrived


def test_the_same_seed_gives_the_nth_packet_the_same_fate_whoever_else_sends() -> None:
    quiet, busy, other = Ether(FOUL, 7), Ether(FOUL, 7), Ether(FOUL, 8)
    for n in range(500):
        busy.send(n * MS, ("T2", "wayside"), b"other")
    busy.take(10_000 * MS)

    once = arrivals(quiet, OUT, 400)

    assert arrivals(busy, OUT, 400) == once
    assert arrivals(other, OUT, 400) != once
    assert arrivals(Ether(FOUL, 7), BACK, 400) != once


def test_packets_are_lost_doubled_delayed_and_overtaken_at_the_configured_rates() -> None:
    ether = Ether(FOUL, 1)

    arrived = arrivals(ether, OUT, 4000)

    counts = ether.counts[OUT]
    assert counts.sent == 4000
    assert 700 < counts.lost < 900
    assert 250 < counts.doubled < 390
    assert len(arrived) == 4000 - counts.lost + counts.doubled
    delays_ms = [at_ms - int(packet) for at_ms, packet in arrived]
    # The test checks once per millisecond, so a packet shows up to 1 ms later.
    assert (min(delays_ms), max(delays_ms)) == (6, 15)
    overtaken = [int(b) < int(a) for (_, a), (_, b) in itertools.pairwise(arrived)]
    assert sum(overtaken) > 500


def test_a_one_way_cut_leaves_the_other_direction_and_later_packets_unchanged() -> None:
    whole, cut = Ether(FOUL, 3), Ether(FOUL, 3)
    cut.cut(ways_of("mute", "T1"))
    for n in range(100):
        whole.send(0, OUT, b"%d" % n)
        cut.send(0, OUT, b"%d" % n)
        cut.send(0, BACK, b"back")
    there = [target for target, _ in cut.take(1000 * MS)]
    assert set(there) == {"T1"}
    assert (cut.counts[OUT].cut, cut.counts[BACK].cut) == (100, 0)
    whole.take(1000 * MS)

    cut.heal(ways_of("heal", "T1"))

    assert arrivals(cut, OUT, 100) == arrivals(whole, OUT, 100)


def test_without_faults_no_packet_is_lost_or_late() -> None:
    ether = Ether(Weather(delay_ns=0, spread_ns=0), 1)

    assert arrivals(ether, OUT, 50) == [(n, b"%d" % n) for n in range(50)]
    assert ether.due_ns() is None
    assert ether.told() == {"T1 > wayside": {"sent": 50, "lost": 0, "cut": 0, "doubled": 0}}


def test_only_packets_of_ipv4_have_a_destination_here() -> None:
    packet = bytes([0x45, *[0] * 15, 10, 144, 0, 2])

    assert destination_of(packet) == "10.144.0.2"
    assert destination_of(packet[:19]) is None
    assert destination_of(b"\x60" + packet[1:]) is None


def test_an_invalid_order_is_refused() -> None:
    with pytest.raises(ValueError, match="hold: unknown order"):
        ways_of("hold", "T1")


def test_any_network_option_requests_networks() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=1)
    add_options(parser)

    def asked(*words: str) -> OwnNetworks | None:
        return networks_of(parser.parse_args(words), needed=False)

    assert asked() is None
    assert asked("--networks") == OwnNetworks(0.0, 0.0, 0.0, 0.0, 1)
    assert asked("--loss", "0.02", "--seed", "9") == OwnNetworks(0.0, 0.0, 0.02, 0.0, 9)
    assert networks_of(parser.parse_args([]), needed=True) is not None


@pytest.mark.parametrize(
    "words", [["--loss", "1"], ["--loss", "-0.1"], ["--delay", "x"], ["--jitter", "99999"]]
)
def test_an_invalid_share_or_delay_is_refused(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["line", *words])

    assert words[0] in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--bench", "lockstep", "--loss", "0.1"], "lockstep has no network"),
        (["--bench", "lockstep", "--mute-master-at", "2"], "not in lockstep"),
        (["--networks", "--line-radio", "tcp/127.0.0.1:7448"], "does not go with networks"),
        (["--delay", "5", "--secure", "keys"], "does not go with networks"),
    ],
)
def test_options_incompatible_with_networks_are_refused(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["line", *words]) == 2

    assert complaint in capsys.readouterr().err
