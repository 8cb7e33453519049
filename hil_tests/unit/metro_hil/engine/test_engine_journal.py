"""The journal: truncation, damage and double writes neither invent nor lose a result."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metro_hil.engine.errors import EngineError
from metro_hil.engine.journal import (
    Journal,
    JournalDamageError,
    JournalHead,
    JournalLine,
    LostAttempt,
    Session,
    encode_line,
    once_each,
    parse_journal,
    read_journal,
    refuse_damage,
    same_result,
)
from metro_hil.model.case import CaseEvent, CaseResult, Host, MonitorResult, Verdict

HEAD = JournalHead("f00d", 3)
WORDS = st.text(max_size=12)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
RESULTS = st.builds(
    CaseResult,
    case_id=st.text(min_size=1, max_size=12),
    index=st.integers(0, 10**6),
    verdict=st.sampled_from(Verdict),
    reason=WORDS,
    sim_s=NUMBERS,
    frames=st.integers(0, 2**62),
    chain=WORDS,
    monitors=st.lists(
        st.builds(
            MonitorResult,
            name=WORDS,
            verdict=st.sampled_from(Verdict),
            margin=st.none() | NUMBERS,
            unit=WORDS,
        ),
        max_size=2,
    ).map(tuple),
    measures=st.dictionaries(WORDS, st.none() | NUMBERS, max_size=2),
    events=st.lists(st.builds(CaseEvent, NUMBERS, WORDS), max_size=2).map(tuple),
)


def result(number: int, verdict: Verdict = Verdict.PASS, **more: Any) -> CaseResult:
    return CaseResult(case_id=f"a/s{number}", index=number, verdict=verdict, **more)


def written(results: list[CaseResult]) -> bytes:
    lines = [JournalLine(head=HEAD), *(JournalLine(result=one) for one in results)]
    return b"".join(encode_line(line) for line in lines)


@given(st.lists(RESULTS, max_size=6))
def test_what_is_written_is_read(results: list[CaseResult]) -> None:
    content = parse_journal(written(results))

    assert content.results == results
    assert content.head == HEAD
    assert content.damaged == []


@settings(max_examples=20)
@given(st.lists(RESULTS, min_size=1, max_size=3))
def test_a_journal_cut_off_at_any_byte_keeps_every_whole_line(results: list[CaseResult]) -> None:
    """The oracle counts line ends, because JSON escapes those inside strings."""
    data = written(results)

    for size in range(len(data) + 1):
        content = parse_journal(data[:size])

        whole = data[:size].count(b"\n")
        assert content.results == results[: max(0, whole - 1)]
        assert content.damaged == []
        assert content.whole_bytes == len(b"".join(data.splitlines(keepends=True)[:whole]))


@given(st.lists(RESULTS, min_size=2, max_size=5), st.data())
def test_any_changed_byte_is_detected_in_its_line_and_only_there(
    results: list[CaseResult], data: st.DataObject
) -> None:
    text = bytearray(written(results))
    place = data.draw(st.integers(0, len(text) - 1).filter(lambda place: text[place] != ord(b"\n")))
    other = data.draw(st.integers(0, 255).filter(lambda b: b not in (text[place], ord(b"\n"))))
    line = text[:place].count(b"\n") + 1

    text[place] = other

    content = parse_journal(bytes(text))
    assert content.damaged == [line]
    assert content.results == [one for at, one in enumerate(results, start=2) if at != line]


def test_a_torn_end_is_cut_off_and_writing_continues_after_the_last_complete_line(
    tmp_path: Path,
) -> None:
    path = tmp_path / "journal.jsonl"
    data = written([result(0), result(1)])
    head = data.index(b"\n") + 1
    for size in (*range(head, len(data), 11), len(data) - 1, len(data)):
        path.write_bytes(data[:size])

        journal = Journal(path, HEAD)
        found = len(journal.found.results)
        for number in range(found, 3):
            journal.append(result(number))
        journal.close()

        content = read_journal(path)
        assert (content.results, content.damaged) == ([result(0), result(1), result(2)], [])


def test_a_reader_of_a_damaged_journal_names_the_line(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    damaged = written([result(0), result(1), result(2)]).replace(b"a/s1", b"a/s7")
    path.write_bytes(damaged)

    with pytest.raises(JournalDamageError, match=r"journal\.jsonl: line 3: damaged.*hil resume"):
        refuse_damage(path, read_journal(path))

    assert path.read_bytes() == damaged


def test_only_the_damaged_line_is_left_out_and_the_old_file_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    damaged = written([result(0), result(1), result(2)]).replace(b"a/s1", b"a/s7")
    path.write_bytes(damaged)

    journal = Journal(path, HEAD)
    journal.close()

    assert journal.left_out == 1
    assert read_journal(path).results == [result(0), result(2)]
    assert read_journal(path).damaged == []
    assert path.with_suffix(".damaged").read_bytes() == damaged


def test_a_damaged_head_is_written_again(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_bytes(written([result(0)]).replace(b"f00d", b"f00f"))

    Journal(path, HEAD).close()

    assert (read_journal(path).head, read_journal(path).results) == (HEAD, [result(0)])


def test_two_processes_never_write_the_same_journal(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    first = Journal(path, HEAD)

    with pytest.raises(EngineError, match="another process is running this campaign"):
        Journal(path, HEAD)

    first.close()
    Journal(path, HEAD).close()


def test_the_journal_of_another_campaign_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    Journal(path, HEAD).close()

    with pytest.raises(EngineError, match="another campaign"):
        Journal(path, JournalHead("beef", 3))


def test_all_kinds_of_lines_are_read_back(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    attempt, session = LostAttempt("a/s0", 1, "signal SIGKILL"), Session("now", "0.1", "crew")
    journal = Journal(path, HEAD)

    for entry in (session, attempt, result(0)):
        journal.append(entry)

    content = read_journal(path)
    journal.close()
    assert (content.sessions, content.lost_attempts) == ([session], [attempt])
    assert content.results == [result(0)]


def test_of_two_lines_for_a_case_the_first_counts() -> None:
    first, second = result(1, reason="first"), result(1, reason="second")

    once = once_each([first, result(0), second])

    assert list(once.values()) == [result(0), first]


def test_only_the_host_may_differ_between_equal_results() -> None:
    served = CaseResult(case_id="a", index=0, verdict=Verdict.PASS, host=Host(wall_s=3.0))

    assert same_result(served, CaseResult(case_id="a", index=0, verdict=Verdict.PASS))
    assert not same_result(served, CaseResult(case_id="a", index=0, verdict=Verdict.FAIL))
    assert not same_result(
        served, CaseResult(case_id="a", index=0, verdict=Verdict.PASS, chain="00")
    )
