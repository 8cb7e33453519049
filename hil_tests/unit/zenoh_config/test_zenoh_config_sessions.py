"""The shipped session settings are ones that zenoh takes, with the endpoint that was asked for."""

import json

import pytest
import zenoh

from zenoh_config.sessions import DEFAULT_ENDPOINT, SessionRole, session_settings


def setting(role: SessionRole, key: str, endpoint: str = DEFAULT_ENDPOINT) -> object:
    value: object = json.loads(
        zenoh.Config.from_json5(session_settings(role, endpoint)).get_json(key)
    )
    return value


def test_a_train_is_a_client_that_connects() -> None:
    assert setting(SessionRole.TRAIN, "mode") == "client"
    assert setting(SessionRole.TRAIN, "connect/endpoints", "tcp/wayside.example:7000") == [
        "tcp/wayside.example:7000?rel=1"
    ]


def test_a_wayside_is_a_router_that_listens() -> None:
    """As a peer it would silently pass nothing on."""
    assert setting(SessionRole.WAYSIDE, "mode") == "router"
    assert setting(SessionRole.WAYSIDE, "listen/endpoints", "tcp/[::1]:7000") == [
        "tcp/[::1]:7000?rel=1"
    ]


@pytest.mark.parametrize("role", SessionRole)
def test_nothing_leaves_the_machine_unasked(role: SessionRole) -> None:
    assert setting(role, "scouting/multicast/enabled") is False


def test_the_wayside_tells_peers_of_each_other_and_clients_of_nobody() -> None:
    """Without being told of each other peers open sessions, and nothing is delivered, silently."""
    assert [setting(role, "scouting/gossip/enabled") for role in SessionRole] == [False, True, True]


def test_a_peer_listens_where_it_is_told_and_never_gives_up_the_wayside() -> None:
    text = session_settings(SessionRole.PEER, "tcp/wayside.example:7000", "tcp/[fe80::1]:0")
    config = zenoh.Config.from_json5(text)

    assert json.loads(config.get_json("mode")) == "peer"
    assert json.loads(config.get_json("listen/endpoints")) == ["tcp/[fe80::1]:0?rel=1"]
    assert json.loads(config.get_json("connect/endpoints")) == ["tcp/wayside.example:7000?rel=1"]
    assert json.loads(config.get_json("connect/timeout_ms")) == -1


@pytest.mark.parametrize("listens_at", ["here", "udp/127.0.0.1:0", "tcp/127.0.0.1:65536"])
def test_where_a_peer_cannot_listen_is_named(listens_at: str) -> None:
    with pytest.raises(ValueError, match="it has the form tcp/HOST:PORT") as caught:
        session_settings(SessionRole.PEER, DEFAULT_ENDPOINT, listens_at)

    assert str(caught.value).startswith(f"{listens_at}: ")


@pytest.mark.parametrize("role", SessionRole)
@pytest.mark.parametrize(
    "endpoint",
    [
        "", "nonsense", "127.0.0.1:7447", "udp/127.0.0.1:7447", "tcp/127.0.0.1", "tcp/:7447",
        "tcp/127.0.0.1:0", "tcp/127.0.0.1:65536", 'tcp/h:1"]', "tcp/h:1?rel=0", "tcp/a b:1",
    ],
)  # fmt: skip
def test_an_endpoint_that_is_none_is_named(role: SessionRole, endpoint: str) -> None:
    with pytest.raises(ValueError, match="it has the form tcp/HOST:PORT") as caught:
        session_settings(role, endpoint)

    assert str(caught.value).startswith(f"{endpoint}: ")
