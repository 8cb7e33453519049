"""What a run of a line leaves: its story counts its seconds as its log is read."""

from pathlib import Path

from firmware_py.ports import RadioMessage
from metro_hil.line_desk.log import read_log
from metro_hil.t2t_run.record import LINE_LOG, STORY, LineRecord
from zenoh_config.codec import BENCH_KEY

MS = 1_000_000


def test_the_story_counts_from_the_first_message_of_the_log(tmp_path: Path) -> None:
    said: list[tuple[float, str]] = []
    record = LineRecord(tmp_path, lambda at_s, words: said.append((at_s, words)))
    record.tell(4_000_000 * MS, "nothing was heard yet")
    for at_ms in (5_000_000, 5_000_700):
        record.hears([RadioMessage(at_ms * MS, "m/loop/w/9/hb/1/all", b"12")])
    record.tell(5_001_500 * MS, "something happens")
    record.close()

    assert said == [(0.0, "nothing was heard yet"), (1.5, "something happens")]
    assert (tmp_path / STORY).read_text() == (
        "    0.00 s  nothing was heard yet\n    1.50 s  something happens\n"
    )
    # Latencies need its stamps by the clock of those who sent.
    assert [each.at_s for each in read_log(tmp_path / LINE_LOG, BENCH_KEY)] == [5000.0, 5000.7]
