"""The committed document of the train-to-train protocol agrees with the code, and its keys are
valid."""

import re
from pathlib import Path

import zenoh

from metro_tools import t2t_doc
from zenoh_config import keys, t2t_keys
from zenoh_config.t2t import BROADCAST, AreaAuthority, Heartbeat, Phase, RosterAck
from zenoh_config.t2t_types import T2T_TYPES

ROOT = Path(__file__).parents[2]
DOCUMENT = ROOT / "docs" / "design" / "train_to_train.md"


def test_the_committed_document_is_current() -> None:
    assert t2t_doc.main(["--check", str(DOCUMENT)]) == 0, (
        "run python -m metro_tools.t2t_doc in the project's folder"
    )


def test_every_test_and_module_named_in_the_document_exists() -> None:
    named = re.findall(
        r"`((?:vobc|plant_emulator|zenoh_config|hil_tests)/[a-z0-9_/]+\.py)`", text()
    )

    assert named
    assert [each for each in named if not (ROOT / each).exists()] == []


def test_every_race_of_the_paper_has_a_line() -> None:
    for number in range(1, 18):
        assert f"\n| R{number} | " in text()


def test_every_kind_of_message_has_its_own_key() -> None:
    assert set(t2t_keys.CHUNKS) == set(T2T_TYPES)
    assert len(set(t2t_keys.CHUNKS.values())) == len(T2T_TYPES)


def test_zenoh_accepts_every_key_and_readers_receive_exactly_their_messages() -> None:
    heartbeat = Heartbeat(7, BROADCAST, 2, 1, 1, 1, 0, Phase.ISSUING, 0, 1)
    authority = AreaAuthority(7, 4, 2, 1, 1, 1, 0, 1, 0, 9.0, 1.0, 0, 1, ())
    ack = RosterAck(65_001, 7, 2, 1, 1, 1, 0, 1)
    readers = {
        "4": t2t_keys.of_train("Loop", 4, (2,)),
        "5": t2t_keys.of_train("Loop", 5, (1, 3)),
        "7": t2t_keys.of_train("Loop", 7, (1, 2)),
        "arbiter": t2t_keys.of_arbiter("Loop", 65_001),
        "wayside": t2t_keys.of_wayside("Loop"),
    }

    def heard(message: Heartbeat | AreaAuthority | RosterAck) -> set[str]:
        key = str(zenoh.KeyExpr(t2t_keys.key_of("Loop", message)))
        return {
            name
            for name, wanted in readers.items()
            if any(keys.matches(each, key) for each in wanted)
        }

    assert heard(heartbeat) == {"4", "7", "wayside"}
    assert heard(authority) == {"4"}
    assert heard(ack) == {"7"}


def text() -> str:
    return DOCUMENT.read_text(encoding="utf-8")
