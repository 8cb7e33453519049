"""Zenoh accepts the shipped session settings, with the requested endpoint."""

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
    """In peer mode the wayside would silently forward nothing."""
    assert setting(SessionRole.WAYSIDE, "mode") == "router"
    assert setting(SessionRole.WAYSIDE, "listen/endpoints", "tcp/[::1]:7000") == [
        "tcp/[::1]:7000?rel=1"
    ]


@pytest.mark.parametrize("role", SessionRole)
def test_the_default_settings_do_not_leave_the_machine(role: SessionRole) -> None:
    assert setting(role, "scouting/multicast/enabled") is False


def test_the_wayside_announces_peers_to_each_other_but_not_to_clients() -> None:
    """Without gossip, peers open sessions to each other but silently deliver nothing."""
    assert [setting(role, "scouting/gossip/enabled") for role in SessionRole] == [False, True, True]


def test_a_peer_listens_at_its_endpoint_and_keeps_trying_the_wayside() -> None:
    text = session_settings(SessionRole.PEER, "tcp/wayside.example:7000", "tcp/[fe80::1]:0")
    config = zenoh.Config.from_json5(text)

    assert json.loads(config.get_json("mode")) == "peer"
    assert json.loads(config.get_json("listen/endpoints")) == ["tcp/[fe80::1]:0?rel=1"]
    assert json.loads(config.get_json("connect/endpoints")) == ["tcp/wayside.example:7000?rel=1"]
    assert json.loads(config.get_json("connect/timeout_ms")) == -1


@pytest.mark.parametrize("listens_at", ["here", "udp/127.0.0.1:0", "tcp/127.0.0.1:65536"])
def test_an_endpoint_where_a_peer_cannot_listen_is_named(listens_at: str) -> None:
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
def test_an_invalid_endpoint_is_refused_by_name(role: SessionRole, endpoint: str) -> None:
    with pytest.raises(ValueError, match="it has the form tcp/HOST:PORT") as caught:
        session_settings(role, endpoint)

    assert str(caught.value).startswith(f"{endpoint}: ")
