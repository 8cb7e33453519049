"""`hil line` tells what happens, and says what does not fit instead of running."""

import pytest

from metro_hil.hil_command import main


def test_it_says_who_commands_and_ends_with_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["line", "--line", "florence", "--trains", "2", "--for", "3.5"]) == 0

    told = capsys.readouterr().out
    assert "area 2: train 1 commands" in told
    assert "controlled" in told


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--trains", "9"], "room for 1 to 8"),
        (["--trains", "0"], "room for 1 to 8"),
        (["--for", "0"], "--for 0: not a duration"),
        (["--line", "hefei"], "hefei: "),
        (["--line", "nowhere.toml"], "nowhere.toml: no such file"),
    ],
)
def test_what_does_not_fit_is_said_in_one_line(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["line", *words]) == 2

    told = capsys.readouterr().err
    assert complaint in told
    assert len(told.splitlines()) == 1
