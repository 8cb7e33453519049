"""Options of network namespaces, on the command line and between programs."""

import argparse
from typing import Final, NamedTuple

DELAY_MAX_MS: Final = 10_000.0


class OwnNetworks(NamedTuple):
    """Own networks for the controllers, and the faults of packets between them."""

    delay_ms: float
    jitter_ms: float
    """Upper bound of a random extra delay for each packet."""
    loss_ratio: float
    duplicate_ratio: float
    seed: int


def ratio(text: str) -> float:
    """Parse a share of packets, for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not a share of packets from 0 to below 1")
    return value


def milliseconds(text: str) -> float:
    """Parse a delay, for argparse."""
    try:
        value_ms = float(text)
    except ValueError:
        value_ms = -1.0
    if not 0.0 <= value_ms <= DELAY_MAX_MS:
        raise argparse.ArgumentTypeError(f"{text} is not a delay from 0 to {DELAY_MAX_MS:g} ms")
    return value_ms


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that `networks_of` reads."""
    group = parser.add_argument_group(
        "own networks",
        "Each option puts every controller into its own network namespace. Its only device leads "
        "to the wayside through a program that loses, delays and duplicates IP packets, as --seed "
        "determines. This needs root or user namespaces, and /dev/net/tun.",
    )
    group.add_argument("--networks", action="store_true", help="own networks without packet faults")
    for name, kind, unit, words in (
        ("delay", milliseconds, "MS", "delay of each packet"),
        (
            "jitter",
            milliseconds,
            "MS",
            "maximum random extra delay, which changes the order of packets",
        ),
        ("loss", ratio, "RATIO", "share of lost packets, such as 0.02"),
        ("duplicate", ratio, "RATIO", "share of packets that arrive twice"),
    ):
        group.add_argument(
            f"--{name}",
            type=kind,
            default=0.0,
            dest=f"{name}_{unit.lower()}",
            metavar=unit,
            help=words,
        )
    group.add_argument("--apart", action="store_true", help=argparse.SUPPRESS)


def networks_of(options: argparse.Namespace, *, needed: bool) -> OwnNetworks | None:
    """Return the networks; None if all programs share this machine's network.

    Args:
        needed: a fault needs own networks.
    """
    figures = (options.delay_ms, options.jitter_ms, options.loss_ratio, options.duplicate_ratio)
    if not (options.networks or needed or any(figures)):
        return None
    return OwnNetworks(*figures, options.seed)
