"""One identifier may have different meanings on two buses: all verbs keep channels apart."""

import json
from pathlib import Path

import pyarrow.parquet
import pytest

from canlog import LogError, load_bus, read
from canlog.command import main
from canlog.views.page_data import page_data
from canlog.views.traces import find_names, trace_of

HEAD = 'VERSION ""\nBU_: A\n'
BODY = HEAD + 'BO_ 256 Speed: 2 A\n SG_ V : 0|16@1+ (1,0) [0|0] "km/h" A\n'
DRIVE = HEAD + 'BO_ 256 Door: 2 A\n SG_ Open : 0|1@1+ (1,0) [0|1] "" A\n'
EITHER = HEAD + 'BO_ 512 Both: 1 A\n SG_ B : 0|8@1+ (1,0) [0|0] "" A\n'


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log with one identifier on two channels, and a message of a third file on `can1`."""
    for name, text in (("body.dbc", BODY), ("drive.dbc", DRIVE), ("either.dbc", EITHER)):
        (tmp_path / name).write_text(text)
    lines = []
    for at in range(20):
        lines.append(f"({1_700_000_000 + at / 100:.6f}) can0 100#{at:02X}00")
        lines.append(f"({1_700_000_000 + at / 100 + 0.003:.6f}) can1 100#{at % 2:02X}FF")
    lines.append("(1700000001.000000) can1 200#07")
    path = tmp_path / "x.log"
    path.write_text("".join(f"{line}\n" for line in lines))
    return path


def bound(log: Path) -> list[str]:
    """Return `--dbc` options with a file for each channel, and one for all."""
    folder = log.parent
    return [
        *("--dbc", f"can0={folder / 'body.dbc'}", "--dbc", f"can1={folder / 'drive.dbc'}"),
        *("--dbc", str(folder / "either.dbc")),
    ]


def test_a_message_on_two_channels_is_two_tables(log: Path) -> None:
    found = read(log, dbc=log.parent / "body.dbc")

    assert list(found.messages) == ["can0:Speed", "can1:Speed"]
    assert found.table("can0:Speed")["V"].tolist() == list(range(20))
    assert found.table("can1:Speed").rows.tolist() == list(range(1, 40, 2))
    with pytest.raises(LogError, match="several channels have it; name one of can0:Speed"):
        found.table("Speed")


def test_each_channel_is_decoded_with_its_own_file(log: Path) -> None:
    folder = log.parent
    bus = load_bus([f"can0={folder / 'body.dbc'}", f"can1={folder / 'drive.dbc'}",
                    folder / "either.dbc"])  # fmt: skip
    found = read(log, dbc=bus)

    assert list(found.messages) == ["Speed", "Door", "Both"]
    assert found.table("Speed")["V"].tolist() == list(range(20))
    assert found.table("Door")["Open"].tolist() == [0, 1] * 10
    assert found.table("Both")["B"].tolist() == [7]
    assert found.unknown == ()


def test_a_file_of_one_channel_decodes_no_other(log: Path) -> None:
    found = read(log, dbc=f"can0={log.parent / 'body.dbc'}")

    assert list(found.messages) == ["Speed"]
    assert found.table("Speed").rows.tolist() == list(range(0, 40, 2))
    assert len(found.unknown) == 2


def test_show_decodes_by_channel_and_shows_one_alone(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["show", str(log), "--no-pager", *bound(log)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert ("can0" in lines[0], "Speed" in lines[0], "V 0 km/h" in lines[0]) == (True, True, True)
    assert ("can1" in lines[1], "Door" in lines[1], "Open 0" in lines[1]) == (True, True, True)

    assert main(["show", str(log), "--no-pager", "--channel", "can1", *bound(log)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 21
    assert all("can1" in line for line in lines)


def test_a_channel_that_the_log_lacks_is_refused_with_those_it_has(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["show", str(log), "--no-pager", "--channel", "can7"]) == 2
    assert "has frames of can0, can1" in capsys.readouterr().err


def test_exports_have_a_table_and_a_column_for_each_channel(log: Path) -> None:
    folder = log.parent
    code = main(["extract", str(log), "--dbc", str(folder / "body.dbc"), "-o", str(folder / "t")])

    assert code == 0
    for name in ("can0", "can1"):
        table = pyarrow.parquet.read_table(folder / "t" / f"{name}.Speed.parquet")
        assert table.column("channel").to_pylist() == [name] * 20


def test_statistics_are_of_each_channel(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stats", str(log), "--as", "json", *bound(log)]) == 0

    told = json.loads(capsys.readouterr().out)
    rows = {(row["channel"], row["message"]): row["frames"] for row in told["messages"]}
    assert rows == {("can0", "Speed"): 20, ("can1", "Door"): 20, ("can1", "Both"): 1}
    assert [bus["channel"] for bus in told["buses"]] == ["can0", "can1"]


@pytest.mark.parametrize("form", ["blf", "asc", "trc", "mf4"])
def test_can0_stays_the_first_channel(log: Path, form: str) -> None:
    """Formats that number channels from 1 keep can0 first, and the copy equals the log."""
    target = log.parent / f"y.{form}"

    assert main(["convert", str(log), str(target)]) == 0
    frames = read(target).frames
    assert [frames.channels[at] for at in frames.channel][:2] == ["can1", "can2"]
    assert main(["diff", str(log), str(target), "--dbc", str(log.parent / "body.dbc")]) == 0


def test_diff_tells_the_channel_that_differs(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = log.parent / "other.log"
    other.write_text(log.read_text().replace("can1 100#01FF", "can1 100#05FF", 1))

    assert main(["diff", str(log), str(other), "--dbc", str(log.parent / "body.dbc")]) == 1

    said = capsys.readouterr().out
    assert "first divergence: can1:Speed.V" in said
    assert "can0:Speed:" not in said


def test_plots_and_the_page_name_the_channel(log: Path) -> None:
    found = read(log, dbc=log.parent / "body.dbc")

    assert find_names(found, "*Speed.V") == ["can0:Speed.V", "can1:Speed.V"]
    assert trace_of(found, "can0:Speed.V").values.tolist() == list(range(20))
    with pytest.raises(LogError, match=r"can0:Speed\.V"):
        find_names(found, "V")
    with pytest.raises(LogError, match=r"name one of can0:Speed\.V, can1:Speed\.V"):
        find_names(found, "Speed.V")
    page = page_data(found, "x", ["can1:Speed.V"], with_frames=True)
    names = [message["name"] for message in page.head["messages"]]
    assert sorted(names) == ["200", "can0:Speed", "can1:Speed"]
