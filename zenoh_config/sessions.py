"""Settings of the zenoh sessions that trains and wayside open, with the endpoint filled in."""

import enum
import re
from importlib import resources
from typing import Final

DEFAULT_ENDPOINT: Final = "tcp/127.0.0.1:7447"
"""What the shipped settings name, so that they work as they are."""
LINE_ENDPOINT: Final = "tcp/127.0.0.1:7448"
"""Of a whole line's wayside, beside that of a single train's."""

_ENDPOINT: Final = re.compile(
    r"tcp/(?P<host>\[[0-9a-fA-F:.]+\]|[A-Za-z0-9._-]+):(?P<port>[0-9]{1,5})"
)


class Role(enum.Enum):
    """The value is the stem of the settings file."""

    TRAIN = "train"
    WAYSIDE = "wayside"


def session_settings(role: Role, endpoint: str = DEFAULT_ENDPOINT) -> str:
    """JSON5 for zenoh: a wayside listens at the endpoint, a train connects to it.

    Raises ValueError for an endpoint that is not `tcp/HOST:PORT`.
    """
    check_endpoint(endpoint)
    text = (resources.files("zenoh_config") / f"{role.value}.json5").read_text(encoding="utf-8")
    assert text.count(DEFAULT_ENDPOINT) == 1
    return text.replace(DEFAULT_ENDPOINT, endpoint)


def check_endpoint(endpoint: str) -> None:
    found = _ENDPOINT.fullmatch(endpoint)
    if found is None or not 0 < int(found["port"]) < 65536:
        raise ValueError(f"{endpoint}: not an endpoint; it has the form tcp/HOST:PORT")
