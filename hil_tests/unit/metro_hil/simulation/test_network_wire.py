"""Messages as bytes on the simulated network are decoded once, whatever the number of receivers."""

import pytest

from hil_tests.unit.vobc.train_to_train.test_t2t_envelope import REPORT
from metro_hil.simulation import wire
from metro_hil.simulation.wire import OPENED_MAX, RealCodec
from zenoh_config.codec import unpack
from zenoh_config.messages import RefusedReason


def test_all_receivers_of_the_same_bytes_get_the_same_message(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opened: list[bytes] = []

    def counted(payload: bytes) -> object:
        opened.append(payload)
        return unpack(payload)

    monkeypatch.setattr(wire, "unpack", counted)
    codec = RealCodec()
    sealed = codec.seal(REPORT)

    assert [codec.open(sealed) for _ in range(3)] == [REPORT] * 3
    assert opened == [sealed]


def test_damaged_bytes_are_refused_and_counted_each_time() -> None:
    codec = RealCodec()
    sealed = codec.seal(REPORT)
    damaged = sealed[:-1] + bytes([sealed[-1] ^ 1])

    assert [codec.open(each) for each in (damaged, sealed, damaged)] == [None, REPORT, None]
    assert codec.refusals == {RefusedReason.WRONG_CODE: 2}


def test_old_messages_are_dropped_from_the_cache() -> None:
    codec = RealCodec()
    for n in range(OPENED_MAX + 100):
        codec.open(n.to_bytes(4, "big"))

    assert len(codec._opened) == OPENED_MAX
