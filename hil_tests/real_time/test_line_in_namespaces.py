"""Trains in their own network namespaces: packets lost there are lost for real programs.

Where the kernel or missing rights refuse such networks, these tests check the refusal and warn that
the rest is BLOCKED.
"""

import os
import socket
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable

from metro_hil.line.network.namespaces import (
    PACKET_BYTES,
    REFUSED,
    Cable,
    NamespaceError,
    cable_away,
    destination_of,
    join,
)
from metro_hil.line.network.packet_faults import Ether
from metro_hil.model.run_options import EXIT_ENVIRONMENT
from metro_hil.simulation.links import Weather

HERE, THERE = "10.145.0.1", "10.145.0.2"
PACKETS = 200
FOUL = Weather(delay_ns=0, spread_ns=20_000_000, loss_share=0.2, double_share=0.2)
WAY = (HERE, THERE)


def in_network(cable: Cable, call: Callable[[], socket.socket]) -> socket.socket:
    """Open a socket in that network; it stays there whatever thread uses it."""
    opened: list[socket.socket] = []

    def go() -> None:
        join(f"/proc/self/fd/{cable.namespace}")
        opened.append(call())

    thread = threading.Thread(target=go)
    thread.start()
    thread.join()
    return opened[0]


def bound_to(address: str) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind((address, 7000))
    made.settimeout(0.0)
    return made


def predicted(weather: Weather, seed: int) -> list[bytes]:
    """The packets that arrive, in order, of `PACKETS` packets sent at once."""
    ether = Ether(weather, seed)
    for n in range(PACKETS):
        ether.send(0, WAY, b"%d" % n)
    return [packet for _, packet in ether.take(1_000_000_000)]


def blocked(error: NamespaceError) -> None:
    assert "refused" in str(error) or "/dev/net/tun" in str(error) or "network" in str(error)
    warnings.warn(f"{REFUSED}: {error}", stacklevel=2)


def test_programs_in_two_networks_receive_exactly_the_packets_that_the_seed_lets_through() -> None:
    try:
        cables = {HERE: cable_away("radio", HERE), THERE: cable_away("radio", THERE)}
    except NamespaceError as error:
        blocked(error)
        return
    near = in_network(cables[HERE], lambda: bound_to(HERE))
    far = in_network(cables[THERE], lambda: bound_to(THERE))
    ether = Ether(FOUL, 5)
    for n in range(PACKETS):
        near.sendto(b"%d" % n, (THERE, 7000))
        packet = os.read(cables[HERE].file, PACKET_BYTES)
        while destination_of(packet) != THERE:
            packet = os.read(cables[HERE].file, PACKET_BYTES)
        ether.send(0, WAY, packet)
    heard = []
    for _, packet in ether.take(1_000_000_000):
        os.write(cables[THERE].file, packet)
        heard.append(far.recv(PACKET_BYTES))

    assert heard == predicted(FOUL, 5)
    assert len(set(heard)) < PACKETS < len(heard) + ether.counts[WAY].lost
    for each in (near, far):
        each.close()
    for cable in cables.values():
        os.close(cable.file)
        os.close(cable.namespace)


def test_a_deaf_master_is_replaced_and_participates_again_afterwards() -> None:
    words = [
        "--fault",
        "deafen",
        "--trains",
        "3",
        "--rounds",
        "2",
        "--loss",
        "0.01",
        "--delay",
        "2",
    ]
    command = [sys.executable, "-m", "metro_hil.line.failover_trial", *words, "--jitter", "2"]

    ended = subprocess.run(command, capture_output=True, text=True, check=False)

    if ended.returncode == EXIT_ENVIRONMENT:
        assert ended.stderr.startswith(REFUSED)
        warnings.warn(ended.stderr, stacklevel=2)
        return
    # The second round begins only when all trains, including the deafened one, have authority
    # again.
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "2 rounds: all others served" in ended.stdout
    assert ended.stdout.count("'cut': 0,") < 6
