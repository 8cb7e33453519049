"""What is asked of networks of their own, on the command line and between programs."""

import argparse
from typing import Final, NamedTuple

DELAY_MAX_MS: Final = 10_000.0


class OwnNetworks(NamedTuple):
    """Each controller in a network of its own, and what becomes of packets on their way."""

    delay_ms: float
    jitter_ms: float
    """At most so much is added, drawn for each packet."""
    loss_ratio: float
    duplicate_ratio: float
    seed: int


def ratio(text: str) -> float:
    """A share of packets, for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < 1.0:
        raise argparse.ArgumentTypeError(f"{text} is no share of packets from 0 to below 1")
    return value


def milliseconds(text: str) -> float:
    """A delay, for argparse."""
    try:
        value_ms = float(text)
    except ValueError:
        value_ms = -1.0
    if not 0.0 <= value_ms <= DELAY_MAX_MS:
        raise argparse.ArgumentTypeError(f"{text} is no delay from 0 to {DELAY_MAX_MS:g} ms")
    return value_ms


def add_options(parser: argparse.ArgumentParser) -> None:
    """Those that `networks_of` reads."""
    group = parser.add_argument_group(
        "networks of their own",
        "Each of these puts every controller into a network namespace of its own, with nothing in "
        "it but a device that leads to the wayside through a program which loses, delays and "
        "doubles IP packets as --seed says. It takes root or user namespaces, and /dev/net/tun.",
    )
    group.add_argument("--networks", action="store_true", help="with nothing wrong in them")
    for name, kind, unit, words in (
        ("delay", milliseconds, "MS", "each packet takes so long"),
        ("jitter", milliseconds, "MS", "and up to so much longer, which changes their order"),
        ("loss", ratio, "RATIO", "so many are lost, such as 0.02"),
        ("duplicate", ratio, "RATIO", "so many come twice"),
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
    """None: all programs share this machine's network, as nothing takes more.

    Args:
        needed: something else takes them.
    """
    figures = (options.delay_ms, options.jitter_ms, options.loss_ratio, options.duplicate_ratio)
    if not (options.networks or needed or any(figures)):
        return None
    return OwnNetworks(*figures, options.seed)
