"""The recording of the page of a run: how the logs grow, and what it refuses."""

import json
from pathlib import Path

import pytest
from PIL import Image

from metro_tools import page_recording
from metro_tools.page_recording import FROM_S, SHOWN_PX, STEP_S, growing, save


def test_frames_and_events_grow_to_the_whole_run(tmp_path: Path) -> None:
    run, grown = tmp_path / "run", tmp_path / "grown"
    instants = [0.5, FROM_S, FROM_S + STEP_S / 2, FROM_S + 2.5 * STEP_S]
    for folder in (run, grown):
        folder.mkdir()
    frames = [f"({at_s:017.6f}) vcan0 101#00\n" for at_s in instants]
    events = [json.dumps({"t_s": at_s}) + "\n" for at_s in instants[:3]]
    (run / "bus.log").write_text("".join(frames))
    (run / "events.jsonl").write_text("".join(events))

    seen = [(count, (grown / "events.jsonl").read_text()) for count in growing(run, grown)]

    assert seen == [
        (1, events[0]),
        (3, "".join(events)),
        (3, "".join(events)),
        (4, "".join(events)),
    ]
    assert (grown / "bus.log").read_text() == "".join(frames)


def test_the_last_picture_stays_longest(tmp_path: Path) -> None:
    path = tmp_path / "a.webp"
    save([Image.new("RGB", SHOWN_PX, shade) for shade in ("white", "black", "red")], path)

    with Image.open(path) as picture:
        shown = []
        for number in range(3):
            picture.seek(number)
            picture.load()
            shown.append(picture.info["duration"])
    assert shown == [125, 125, 3000]


def test_a_folder_without_logs_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_recording, "browser_path", lambda: "chromium")
    assert page_recording.main([str(tmp_path), "-o", str(tmp_path / "a.webp")]) == 2
    assert "run.toml" in capsys.readouterr().err

    monkeypatch.setattr(page_recording, "browser_path", lambda: None)
    assert page_recording.main([str(tmp_path)]) == 3
    assert "Chromium" in capsys.readouterr().err
