"""The shipped session settings are ones that zenoh takes, with the endpoint that was asked for."""

import json

import pytest
import zenoh

from zenoh_config.sessions import DEFAULT_ENDPOINT, Role, session_settings


def setting(role: Role, key: str, endpoint: str = DEFAULT_ENDPOINT) -> object:
    value: object = json.loads(
        zenoh.Config.from_json5(session_settings(role, endpoint)).get_json(key)
    )
    return value


def test_a_train_is_a_client_that_connects() -> None:
    assert setting(Role.TRAIN, "mode") == "client"
    assert setting(Role.TRAIN, "connect/endpoints", "tcp/wayside.example:7000") == [
        "tcp/wayside.example:7000?rel=1"
    ]


def test_a_wayside_is_a_router_that_listens() -> None:
    """As a peer it would silently pass nothing on."""
    assert setting(Role.WAYSIDE, "mode") == "router"
    assert setting(Role.WAYSIDE, "listen/endpoints", "tcp/[::1]:7000") == ["tcp/[::1]:7000?rel=1"]


@pytest.mark.parametrize("role", Role)
def test_nothing_leaves_the_machine_unasked(role: Role) -> None:
    assert setting(role, "scouting/multicast/enabled") is False
    assert setting(role, "scouting/gossip/enabled") is False


@pytest.mark.parametrize("role", Role)
@pytest.mark.parametrize(
    "endpoint",
    [
        "", "nonsense", "127.0.0.1:7447", "udp/127.0.0.1:7447", "tcp/127.0.0.1", "tcp/:7447",
        "tcp/127.0.0.1:0", "tcp/127.0.0.1:65536", 'tcp/h:1"]', "tcp/h:1?rel=0", "tcp/a b:1",
    ],
)  # fmt: skip
def test_an_endpoint_that_is_none_is_named(role: Role, endpoint: str) -> None:
    with pytest.raises(ValueError, match="it has the form tcp/HOST:PORT") as caught:
        session_settings(role, endpoint)

    assert str(caught.value).startswith(f"{endpoint}: ")
