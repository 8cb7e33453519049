"""The words of a program, and what it says of files that they name."""

import sys

import pytest

from firmware_py.arguments import of_file, words_of


def test_those_of_the_process_count_where_none_are_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["vobc", "run", "é:ü"])

    assert words_of("vobc", None) == ["run", "é:ü"]
    assert words_of("vobc", ()) == []


def test_one_that_is_no_text_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        words_of("hil", ["run", "a\udcff.toml"])

    assert ended.value.code == 2
    assert capsys.readouterr().err.startswith("hil: 'a\\udcff.toml': not UTF-8; ")


def test_of_a_file_its_name_is_said_where_there_is_one() -> None:
    assert of_file(OSError(28, "No space left on device", "x.log")) == (
        "x.log: No space left on device"
    )
    assert of_file(OSError(28, "No space left on device")) == "No space left on device"
    assert of_file(OSError("a text alone")) == "a text alone"
