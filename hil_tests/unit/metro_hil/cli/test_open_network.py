"""A line without certificates is refused where other machines reach it, unless the user insists."""

from pathlib import Path

import pytest

from metro_hil.cli.hil import main as hil
from metro_hil.cli.vobc import main as vobc
from plant_emulator.cli import main as plant
from vobc.cli.command import main as device
from zenoh_config.sessions import check_secured, is_loopback

OPEN = "tcp/192.168.10.1:7448"
LINE = ["--line", "loop", "--line-radio", OPEN]


@pytest.mark.parametrize(
    ("endpoint", "own"),
    [
        ("tcp/127.0.0.1:7448", True),
        ("tcp/127.9.9.9:1", True),
        ("tcp/[::1]:7448", True),
        ("tcp/localhost:7448", True),
        ("tcp/0.0.0.0:7448", False),
        ("tcp/[::]:7448", False),
        ("tcp/128.0.0.1:7448", False),
        ("tcp/wayside.example:7448", False),
        (OPEN, False),
    ],
)
def test_only_an_address_of_this_machine_needs_no_certificates(endpoint: str, own: bool) -> None:
    assert is_loopback(endpoint) is own

    check_secured(endpoint, secured=True, insecure=False)
    check_secured(endpoint, secured=False, insecure=True)
    if own:
        check_secured(endpoint, secured=False, insecure=False)
    else:
        with pytest.raises(ValueError, match="give --secure FOLDER, or --insecure"):
            check_secured(endpoint, secured=False, insecure=False)


@pytest.mark.parametrize(
    ("main", "words"),
    [
        (vobc, ["line", *LINE]),
        (vobc, ["hold", "T1", *LINE]),
        (vobc, ["line", "up", *LINE]),
        (vobc, ["line-log", "--live", *LINE]),
        (vobc, ["run", "--train", "T1", *LINE]),
        (device, ["--train", "1", "--bus", "embedded:x", *LINE]),
        (device, ["--train", "1", "--bus", "embedded:x", *LINE[:2], "--line-peer", OPEN,
                  "--line-radio", "tcp/127.0.0.1:7448"]),
        (plant, ["wayside", *LINE]),
        (hil, ["line", *LINE]),
    ],
)  # fmt: skip
def test_every_program_refuses_an_open_line_in_one_line(
    main: object,
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert callable(main)
    try:
        code = main(words)
    except SystemExit as end:
        code = end.code

    assert code == 2
    said = capsys.readouterr().err
    assert f"{OPEN}: other machines can reach this address" in said
    assert not list(tmp_path.iterdir())
