"""The log of a line's radio read back: decoded, filtered, counted and plotted."""

from pathlib import Path

import pytest

from firmware_py.storage.recorder import RadioLog, SerialDirection
from metro_hil.cli.vobc import main as vobc
from plant_emulator.wayside.detection import Place, key_of, packed
from zenoh_config import t2t_keys
from zenoh_config.codec import pack
from zenoh_config.t2t import BROADCAST, AreaAuthority, Heartbeat, Phase, T2tMessage

MS = 1_000_000
HEAD = (1, 2, 1)
BEAT = Heartbeat(1, BROADCAST, 1, 7, 1, 1, 0, Phase.ISSUING, 2, 1)


def authority(echo_ms: int, term: int = 7, area: int = 1) -> AreaAuthority:
    return AreaAuthority(1, 2, area, term, 1, 2, 0, 1, echo_ms * MS, 900.5, 80.0, 1, 2, ())


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    log = RadioLog(tmp_path / "line.log")

    def said(at_ms: int, message: T2tMessage) -> None:
        topic = t2t_keys.key_of("loop", message)
        log.message(at_ms * MS, SerialDirection.RX, topic, pack(message))

    said(5000, BEAT)
    said(5060, authority(5000))
    said(5180, authority(5100))
    log.message(5200 * MS, SerialDirection.RX, key_of("loop", 2), packed(Place(180.0, 100.0, 16)))
    log.message(5250 * MS, SerialDirection.RX, "m/loop/w/9/hb/1/all", b"\x02\x10" * 30)
    said(6000, Heartbeat(3, BROADCAST, 1, 9, 1, 1, 0, Phase.FENCING, 0, 1))
    said(6010, authority(5990, term=9, area=2))
    log.close()
    return tmp_path


def told(capsys: pytest.CaptureFixture[str], *words: object) -> list[str]:
    assert vobc(["line-log", *map(str, words)]) == 0
    return capsys.readouterr().out.splitlines()


def test_every_message_is_a_line_with_sender_content_and_receiver(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = told(capsys, folder)

    assert len(lines) == 7
    assert lines[0] == (
        "    0.000000  T1 > all  area 1 term 7 #1.1  "
        "Heartbeat: phase issuing, standby 2, roster_version 1, "
        "grants []"
    )
    assert "T1 > T2  area 1 term 7" in lines[1]
    assert "end_m 900.50" in lines[1]
    assert lines[3].endswith("rails of T2: front 180.00 m, rear 100.00 m, 16 axles")
    assert "refused: wrong safety code" in lines[4]


@pytest.mark.parametrize(
    ("words", "seconds"),
    [
        (["--kind", "hb"], ["0.000000", "0.250000", "1.000000"]),
        (["--kind", "Heartbeat"], ["0.000000", "1.000000"]),
        (["--kind", "Refused,Place"], ["0.200000", "0.250000"]),
        (["--source", "T3"], ["1.000000"]),
        (["--to", "all"], ["0.000000", "1.000000"]),
        (["--to", "T2", "--area", "2"], ["1.010000"]),
        (["--since", "0.1", "--until", "0.21"], ["0.180000", "0.200000"]),
    ],
)
def test_only_the_requested_messages_are_shown(
    words: list[str], seconds: list[str], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert [line.split()[0] for line in told(capsys, folder, *words)] == seconds


def test_latencies_ages_and_terms_are_counted(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = told(capsys, folder / "line.log", "--stats")

    assert "refused: 1" in lines
    assert (
        "T2: 3 authorities, latency p50 60 ms, p99 80 ms, greatest 80 ms; age when replaced "
        "p50 60 ms, greatest 180 ms"
    ) in lines
    assert "area 1: 0.00 s term 7 T1, 1.00 s term 9 T3" in lines
    assert any(line.split()[:3] == ["T1", "AreaAuthority", "3"] for line in lines)


def test_seconds_count_from_the_first_message_of_the_log_whatever_the_filter(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = told(capsys, folder, "--stats", "--since", "0.5")

    assert "area 1: 1.00 s term 9 T3" in lines


@pytest.mark.parametrize(
    "words", [["--source", "T99"], ["--area", "9", "--stats"], ["--since", "20", "--until", "30"]]
)
def test_an_empty_filter_result_is_reported(
    words: list[str], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert vobc(["line-log", str(folder), *words]) == 0

    said = capsys.readouterr().err
    assert said == f"vobc: {folder / 'line.log'}: none of 7 messages passes the filters\n"


def test_an_empty_log_is_reported_as_empty(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    RadioLog(tmp_path / "line.log").close()

    assert vobc(["line-log", str(tmp_path)]) == 0

    assert "no message" in capsys.readouterr().err


def test_a_log_of_a_secured_line_asks_for_its_keys(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = RadioLog(tmp_path / "line.log")
    log.message(0, SerialDirection.RX, t2t_keys.key_of("loop", BEAT), pack(BEAT, bytes(32)))
    log.message(9 * MS, SerialDirection.RX, key_of("loop", 2), packed(Place(180.0, 100.0, 16)))
    log.close()

    assert vobc(["line-log", str(tmp_path), "--stats"]) == 0

    said = capsys.readouterr()
    assert "refused: 1" in said.out
    assert "all 1 safety codes are wrong" in said.err
    assert "--secure FOLDER" in said.err


def test_a_partly_damaged_log_does_not_ask_for_keys(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert vobc(["line-log", str(folder), "--stats"]) == 0

    assert capsys.readouterr().err == ""


def test_without_a_name_the_last_run_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert vobc(["line-log"]) == 2
    assert "runs: no run there" in capsys.readouterr().err

    folder = tmp_path / "runs" / "a-line"
    folder.mkdir(parents=True)
    (folder / "line.log").write_text("no log\n", encoding="utf-8")

    assert vobc(["line-log"]) == 2
    assert capsys.readouterr().err.splitlines() == [
        "vobc: reading runs/a-line",
        "vobc: runs/a-line/line.log: not a radio log: its first line is not "
        "t_s,direction,key,payload",
    ]


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["x", "--since", "30", "--until", "20"], "--since 30 is not before --until 20"),
        (["x", "--since", "20", "--until", "20"], "--since 20 is not before --until 20"),
        (["x", "--live"], "x and --live exclude each other"),
        (["x", "--for", "3"], "--for needs --live"),
    ],
)
def test_incompatible_options_are_refused(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert vobc(["line-log", *words]) == 2

    assert capsys.readouterr().err == f"vobc: line-log: {complaint}\n"


def test_the_log_is_plotted(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told(capsys, folder, "--plot", folder / "line.png")

    assert (folder / "line.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (None, "cannot be read: No such file"),
        ("t_s,key\n1,2\n", "its first line is not t_s,direction,key,payload"),
        ("t_s,direction,key,payload\n1,rx,m/loop/w/1,0g\n", "line 2: "),
        ("t_s,direction,key,payload\n1,rx\n", "line 2: "),
    ],
)
def test_an_invalid_log_is_refused_in_one_line(
    content: str | None, complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "x.log"
    if content is not None:
        log.write_text(content)

    assert vobc(["line-log", str(log)]) == 2

    said = capsys.readouterr().err
    assert complaint in said
    assert len(said.splitlines()) == 1


@pytest.mark.parametrize(
    "words", [["--kind", "nonsense"], ["--source", "Tx"], ["--to", "99999"], ["--area", "a"]]
)
def test_an_unknown_name_is_refused(
    words: list[str], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        vobc(["line-log", str(folder), *words])

    assert words[0] in capsys.readouterr().err
