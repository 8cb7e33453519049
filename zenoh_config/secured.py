"""Settings of zenoh sessions with mutual TLS and access control, generated for one line. Pure."""

import re
from collections.abc import Iterable, Sequence
from importlib import resources
from typing import Final

from zenoh_config.keys import line_chunk
from zenoh_config.sessions import DEFAULT_ENDPOINT
from zenoh_config.t2t import ARBITERS_MAX, FIRST_ARBITER

ENDPOINT: Final = "tls/127.0.0.1:7448"
"""Endpoint in secure.json5 and in all settings generated from it."""
WAYSIDE_NAME: Final = "wayside"
TRACK_NAME: Final = "track"
SUPERVISION_NAME: Final = "supervision"
"""Names in the certificates. A train's name is T1, T2, ..., that of an arbiter arbiter1, ..."""
CLIENT_NAMES: Final = (
    SUPERVISION_NAME,
    TRACK_NAME,
    *[f"arbiter{number}" for number in range(1, ARBITERS_MAX + 1)],
)
"""Names of the programs that connect to the wayside and are no trains."""
_FOLDER: Final = '"secure/'
_LINE: Final = "loop"
"""Line of secure.json5."""
_OF_NETWORK: Final = re.compile(
    r" *// begin of a network\n(?P<keys>.*?) *// end of a network\n", re.DOTALL
)
_EXPRESSION: Final = re.compile(rf'"m/{_LINE}/(?P<rest>[^"]*)"')
_EACH_TRAIN, _EACH_ARBITER = (
    re.compile(rf" *// begin of each {kind}\n(?P<one>.*?) *// end of each {kind}\n", re.DOTALL)
    for kind in ("train", "arbiter")
)


def train_name(train: int) -> str:
    return f"T{train}"


def wayside_settings(
    folder: str, line: str, trains: Iterable[int], *, paths: Sequence[str] = ()
) -> str:
    """Return secure.json5 for certificates in `folder`, for the given trains of a line.

    Args:
        paths: names of the paths of a network, each of which is a line of masters; `line` is then
            the name of the network. Empty: the line is no network.
    """
    text = _shipped("secure")
    assert text.count(ENDPOINT) == 1
    assert len(_EACH_TRAIN.findall(text)) == len(_EACH_ARBITER.findall(text)) == 3
    numbers = sorted(trains)
    text = _EACH_TRAIN.sub(lambda found: _for_each(found["one"], numbers), text)
    text = _EACH_ARBITER.sub(lambda found: _for_each_arbiter(found["one"]), text)
    text = _OF_NETWORK.sub(lambda found: found["keys"] if paths else "", text)
    chunks = [line_chunk(name) for name in (line, *paths)]

    def of_each(found: re.Match[str]) -> str:
        return ", ".join(f'"m/{chunk}/{found["rest"]}"' for chunk in chunks)

    return _EXPRESSION.sub(of_each, text.replace(_FOLDER, f'"{folder}/'))


def client_settings(folder: str, name: str) -> str:
    """Return train.json5 with the identity of a program that connects to the wayside."""
    text = _shipped("train")
    link = "    link: {\n"
    assert text.count(link) == 1
    assert text.count(DEFAULT_ENDPOINT) == 1
    tls = (
        '      protocols: ["tls"],\n'
        "      tls: {\n"
        f'        root_ca_certificate: "{folder}/ca.pem",\n'
        f'        connect_certificate: "{folder}/{name}.pem",\n'
        f'        connect_private_key: "{folder}/{name}.key",\n'
        "        enable_mtls: true,\n"
        "        verify_name_on_connect: true,\n"
        "        close_link_on_expiration: true,\n"
        "      },\n"
    )
    # A handshake with certificates takes longer than one without.
    text = text.replace("open_timeout: 1000, accept_timeout: 1000", "open_timeout: 2000")
    text = text.replace("timeout_ms: 2000", "timeout_ms: 4000")
    return text.replace(link, link + tls).replace(DEFAULT_ENDPOINT, ENDPOINT)


def at_endpoint(settings: str, endpoint: str) -> str:
    """Return the settings for `tcp/HOST:PORT` or `tls/HOST:PORT`; both use TLS."""
    return settings.replace(ENDPOINT, "tls/" + endpoint.partition("/")[2])


def _for_each(one: str, trains: Iterable[int]) -> str:
    said = []
    for train in trains:
        text = one.replace("T1", train_name(train)).replace("/w/1/", f"/w/{train}/")
        for kind in ("x", "p", "e", "*"):
            text = text.replace(f'/{kind}/1"', f'/{kind}/{train}"')
        said.append(text)
    return "".join(said)


def _for_each_arbiter(one: str) -> str:
    first = str(FIRST_ARBITER)
    return "".join(
        one.replace("arbiter1", f"arbiter{number}").replace(first, str(FIRST_ARBITER + number - 1))
        for number in range(1, ARBITERS_MAX + 1)
    )


def _shipped(stem: str) -> str:
    return (resources.files("zenoh_config") / f"{stem}.json5").read_text(encoding="utf-8")
