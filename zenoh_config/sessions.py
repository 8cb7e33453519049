"""Settings of the zenoh sessions that trains and wayside open, with the endpoint filled in."""

import enum
import re
from importlib import resources
from typing import Final

DEFAULT_ENDPOINT: Final = "tcp/127.0.0.1:7447"
"""What the shipped settings name, so that they work as they are."""
LINE_ENDPOINT: Final = "tcp/127.0.0.1:7448"
"""Of a whole line's wayside, beside that of a single train's."""
ANY_PORT: Final = "tcp/127.0.0.1:0"
"""What the shipped settings of a peer name as its own endpoint."""

_ENDPOINT: Final = re.compile(
    r"tcp/(?P<host>\[[0-9a-fA-F:.]+\]|[A-Za-z0-9._-]+):(?P<port>[0-9]{1,5})"
)


class SessionRole(enum.Enum):
    """The value is the stem of the settings file."""

    TRAIN = "train"
    """A client of the wayside: all that it says goes through there."""
    PEER = "peer"
    """A train that speaks to others of its kind directly."""
    WAYSIDE = "wayside"


def session_settings(
    role: SessionRole, endpoint: str = DEFAULT_ENDPOINT, listens_at: str = ANY_PORT
) -> str:
    """JSON5 for zenoh: a wayside listens at the endpoint, a train connects to it.

    Args:
        listens_at: of a peer, where others reach it; port 0 is any that is free.

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
    """Raises ValueError for what is not `tcp/HOST:PORT`."""
    address_of(endpoint, port_min=port_min)


def address_of(endpoint: str, *, port_min: int = 1) -> tuple[str, int]:
    """Host, without brackets, and port. Raises ValueError as `check_endpoint` does."""
    found = _ENDPOINT.fullmatch(endpoint)
    if found is None or not port_min <= int(found["port"]) < 65536:
        raise ValueError(f"{endpoint}: not an endpoint; it has the form tcp/HOST:PORT")
    return found["host"].strip("[]"), int(found["port"])
