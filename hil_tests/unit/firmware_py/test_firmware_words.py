"""The arguments of a program, and its messages about the files that they name."""

import sys

import pytest

from firmware_py.arguments import of_file, words_of


def test_the_arguments_of_the_process_are_the_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["vobc", "run", "é:ü"])

    assert words_of("vobc", None) == ["run", "é:ü"]
    assert words_of("vobc", ()) == []


def test_an_argument_that_is_not_utf_8_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        words_of("hil", ["run", "a\udcff.toml"])

    assert ended.value.code == 2
    assert capsys.readouterr().err.startswith("hil: 'a\\udcff.toml': not UTF-8; ")


def test_the_message_of_a_file_error_names_the_file() -> None:
    assert of_file(OSError(28, "No space left on device", "x.log")) == (
        "x.log: No space left on device"
    )
    assert of_file(OSError(28, "No space left on device")) == "No space left on device"
    assert of_file(OSError("a text alone")) == "a text alone"
