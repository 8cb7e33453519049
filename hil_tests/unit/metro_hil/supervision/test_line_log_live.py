"""`vobc line-log --live` shows, counts and plots received messages, and reports silence."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

from firmware_py.ports import RadioMessage
from hil_tests.unit.metro_hil.supervision.test_line_log import BEAT, authority
from metro_hil.cli.vobc import main as vobc
from metro_hil.supervision import radio_log_live
from zenoh_config.codec import pack
from zenoh_config.t2t import T2tMessage
from zenoh_config.t2t_keys import key_of

ENDPOINT = ["--live", "--line-radio", "tcp/127.0.0.1:9"]


class Radio:
    """Receives each of these messages once, at the first reception."""

    def __init__(self, *messages: T2tMessage, connected: bool = True) -> None:
        self._messages, self.connected = messages, connected

    @contextmanager
    def open(self, *_: object, **__: object) -> Iterator["Radio"]:
        yield self

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        heard, self._messages = self._messages, ()
        return [RadioMessage(now_ns, key_of("loop", each), pack(each)) for each in heard]


@pytest.fixture
def receives(monkeypatch: pytest.MonkeyPatch) -> Callable[[Radio], None]:
    monkeypatch.setattr(radio_log_live, "PATIENCE_S", 0.1)
    return lambda radio: monkeypatch.setattr(radio_log_live, "open_radio", radio.open)


def test_it_counts_and_plots_messages_until_the_time_is_over(
    receives: Callable[[Radio], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    receives(Radio(BEAT, authority(5000)))
    plot = tmp_path / "line.png"

    assert vobc(["line-log", *ENDPOINT, "--for", "0.2", "--stats", "--plot", str(plot)]) == 0

    told = capsys.readouterr()
    assert "area 1: 0.00 s term 7 T1" in told.out
    assert "T2: 1 authorities" in told.out
    assert plot.exists()
    assert told.err == ""


def test_it_shows_each_message_as_it_comes(
    receives: Callable[[Radio], None], capsys: pytest.CaptureFixture[str]
) -> None:
    receives(Radio(BEAT))

    assert vobc(["line-log", *ENDPOINT, "--for", "0.1"]) == 0

    assert "T1 > all" in capsys.readouterr().out


def test_it_reports_a_missing_session_once_and_goes_on_trying(
    receives: Callable[[Radio], None], capsys: pytest.CaptureFixture[str]
) -> None:
    receives(Radio(connected=False))

    assert vobc(["line-log", *ENDPOINT, "--for", "0.4"]) == 3

    said = capsys.readouterr().err.splitlines()
    assert said == [
        "vobc: tcp/127.0.0.1:9: no session yet; does a wayside run there? Trying again",
        "vobc: tcp/127.0.0.1:9: no session came up",
    ]


def test_a_connected_silent_line_is_not_reported_as_a_missing_session(
    receives: Callable[[Radio], None], capsys: pytest.CaptureFixture[str]
) -> None:
    receives(Radio())

    assert vobc(["line-log", *ENDPOINT, "--for", "0.3"]) == 0

    assert capsys.readouterr().err == "vobc: tcp/127.0.0.1:9: no message\n"
