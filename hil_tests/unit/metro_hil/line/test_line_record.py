"""The files of a line run: its event log counts seconds in the same way as its radio log."""

import json
from pathlib import Path

from can_dbc.vobc import Cause, Supervision
from firmware_py.ports import RadioMessage
from hil_tests.unit.metro_hil.line.test_line_story import GIVEN, Told
from metro_hil.line.exercise.record import LINE_LOG, STORY, LineRunFiles
from metro_hil.line.exercise.results import results_json
from metro_hil.supervision.radio_log import read_log
from zenoh_config.codec import BENCH_KEY

MS = 1_000_000


def test_the_event_log_counts_from_the_first_message_of_the_radio_log(tmp_path: Path) -> None:
    said: list[tuple[float, str]] = []
    record = LineRunFiles(tmp_path, lambda at_s, words: said.append((at_s, words)))
    record.tell(4_000_000 * MS, "nothing was heard yet")
    for at_ms in (5_000_000, 5_000_700):
        record.on_message([RadioMessage(at_ms * MS, "m/loop/w/9/hb/1/all", b"12")])
    record.tell(5_001_500 * MS, "something happens")
    record.close()

    assert said == [(0.0, "nothing was heard yet"), (1.5, "something happens")]
    assert (tmp_path / STORY).read_text() == (
        "    0.00 s  nothing was heard yet\n    1.50 s  something happens\n"
    )
    # Latencies need the stamps by the clocks of the senders.
    assert [each.at_s for each in read_log(tmp_path / LINE_LOG, BENCH_KEY)] == [5000.0, 5000.7]


def test_results_use_the_seconds_of_the_event_log() -> None:
    told = Told()
    told.on_message(GIVEN, 5050)
    told.story.tells(2, Supervision.EMERGENCY, Cause.OVERSPEED, 5500 * MS)

    results = json.loads(
        results_json(
            *(told.story, 2),
            exit_reason="interrupted",
            complaints=["train 2: it braked"],
            missed=3,
            carried={},
            second_of=lambda at_ns: at_ns / MS / 1000.0 - 5.0,
        )
    )

    assert results["verdict"] == "failed"
    assert results["complaints"] == ["train 2: it braked"]
    assert results["missed_messages"] == 3
    first, second = results["trains"]
    assert (first["front_m"], first["authority_end_m"], first["least_gap_m"]) == (
        1080.0,
        None,
        None,
    )
    assert (second["authority_end_m"], second["term"], second["latency_p50_ms"]) == (900.0, 7, 5050)
    assert second["emergencies"] == [
        {"at_s": 0.5, "cause": "overspeed", "commanded": False, "excused": False}
    ]
