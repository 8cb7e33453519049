"""Settings of the zenoh sessions of trains and wayside, with the endpoint filled in."""

import enum
import ipaddress
import re
from importlib import resources
from typing import Final

DEFAULT_ENDPOINT: Final = "tcp/127.0.0.1:7447"
"""Endpoint in the shipped settings, so that they work unchanged."""
LINE_ENDPOINT: Final = "tcp/127.0.0.1:7448"
"""Endpoint of a whole line's wayside, different from that of a single train's."""
ANY_PORT: Final = "tcp/127.0.0.1:0"
"""Own endpoint of a peer in the shipped settings."""

_ENDPOINT: Final = re.compile(
    r"tcp/(?P<host>\[[0-9a-fA-F:.]+\]|[A-Za-z0-9._-]+):(?P<port>[0-9]{1,5})"
)


class SessionRole(enum.Enum):
    """Role of a session; the value is the name of its settings file."""

    TRAIN = "train"
    """A client of the wayside, through which all its messages go."""
    PEER = "peer"
    """A train that communicates with other trains directly."""
    WAYSIDE = "wayside"


def session_settings(
    role: SessionRole, endpoint: str = DEFAULT_ENDPOINT, listens_at: str = ANY_PORT
) -> str:
    """Return JSON5 for zenoh: a wayside listens at the endpoint, a train connects to it.

    Args:
        listens_at: own endpoint of a peer; port 0 means any free port.

    Raises ValueError for an endpoint that is not `tcp/HOST:PORT`.
    """
    check_endpoint(endpoint)
    text = (resources.files("zenoh_config") / f"{role.value}.json5").read_text(encoding="utf-8")
    assert text.count(DEFAULT_ENDPOINT) == 1
    text = text.replace(DEFAULT_ENDPOINT, endpoint)
    if role is not SessionRole.PEER:
        return text
    check_endpoint(listens_at, port_min=0)
    assert text.count(ANY_PORT) == 1
    return text.replace(ANY_PORT, listens_at)


def check_endpoint(endpoint: str, *, port_min: int = 1) -> None:
    """Raise ValueError for an endpoint that is not `tcp/HOST:PORT`."""
    address_of(endpoint, port_min=port_min)


def check_secured(endpoint: str, *, secured: bool, insecure: bool) -> None:
    """Raise ValueError if other machines can reach a line that is not secured.

    Args:
        insecure: the user confirmed that the network is closed.
    """
    if secured or insecure or is_loopback(endpoint):
        return
    raise ValueError(
        f"{endpoint}: other machines can reach this address, and the line is not secured; give "
        "--secure FOLDER, or --insecure on a network of your own"
    )


def is_loopback(endpoint: str) -> bool:
    """Tell whether only programs of this machine reach the endpoint. Raises ValueError."""
    host, _ = address_of(endpoint, port_min=0)
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def address_of(endpoint: str, *, port_min: int = 1) -> tuple[str, int]:
    """Return host, without brackets, and port. Raises ValueError as `check_endpoint` does."""
    found = _ENDPOINT.fullmatch(endpoint)
    if found is None or not port_min <= int(found["port"]) < 65536:
        raise ValueError(f"{endpoint}: not an endpoint; it has the form tcp/HOST:PORT")
    return found["host"].strip("[]"), int(found["port"])
