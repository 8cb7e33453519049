"""`hil from-run`: a run that a person acted on replays with the same frames."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Final

import pytest

from metro_hil.campaign import plan_cases, read_campaign
from metro_hil.cli.hil import main as hil
from metro_hil.cli.vobc_run import make_results, read_logs
from metro_hil.metrics.comfort import inertia_of
from metro_hil.model.case import as_expected
from metro_hil.model.mission import plan_journey
from metro_hil.model.run_folder import RunFolder, write_config
from metro_hil.model.run_options import parse
from metro_hil.run.dispatch import run_case
from metro_hil.run.lockstep import RealPace, run_lockstep, scenario_of
from plant_emulator.cli.by_hand import DESK_KEYS, FAULT_ACTS, FAULT_RECORD

ACTS: Final[dict[float, tuple[str, object]]] = {
    1.5: (DESK_KEYS, "d"),
    2.0: (FAULT_ACTS, {"start": {"kind": "traction_weak", "gain_ratio": 0.5}}),
    2.6: (DESK_KEYS, "up"),
    3.0: (FAULT_ACTS, {"start": {"kind": "frame_delay", "frames": "TACHO", "delay_s": 0.02}}),
    3.3: (FAULT_ACTS, {"set": 0, "values": {"gain_ratio": 0.8}}),
    4.0: (FAULT_ACTS, {"start": {"kind": "controller_killed"}}),
    4.2: (FAULT_ACTS, {"stop": 1}),
    5.0: (FAULT_ACTS, {"stop": 3}),
    5.2: (FAULT_ACTS, {"start": {"kind": "door_opens"}}),
}
"""What the person does, by the time of the run, s."""
OPTIONS: Final = ("run", "--lockstep", "--from", "II", "--to", "III", "--duration", "6")


@pytest.fixture(scope="module")
def acted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in virtual time with these acts."""
    folder = RunFolder(tmp_path_factory.mktemp("acted"))
    options = parse([*OPTIONS, "--desk", "browser", "--allow-faults"])
    write_config(folder, {"options": options}, 0)
    waiting = dict(ACTS)

    def act(now_ns: int) -> None:
        for at_s in [each for each in waiting if each <= now_ns / 1e9]:
            name, what = waiting.pop(at_s)
            text = what if isinstance(what, str) else json.dumps(what)
            with (folder.path / name).open("a") as end:
                end.write(f"{text}\n")

    journey = plan_journey(options)
    ending = run_lockstep(options, journey, folder, pace=act)
    inertia_kg = inertia_of(scenario_of(options).train)
    results = make_results(folder, journey, ending, read_logs(folder, ending), inertia_kg)
    folder.results.write_text(results.to_json())
    return folder.path


def test_a_run_by_hand_replays_with_the_same_frames(
    acted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hil(["from-run", str(acted), "--out", str(tmp_path / "made"), "--json"]) == 0
    made = json.loads(capsys.readouterr().out)

    assert made["same_frames"] is True
    assert made["result"]["verdict"] == "fail"
    kinds = [each["kind"] for each in made["result"]["faults"]]
    killed = "controller_killed"
    assert kinds == ["traction_weak", "frame_delay", "traction_weak", killed, "door_opens"]
    assert all(each["touched"] for each in made["result"]["faults"][1:])

    campaign = read_campaign(made["scenario"])
    (case,) = plan_cases(campaign)
    files = {name: Path(made["scenario"]).parent / name for name in campaign.files}
    again = run_case(case, files=files)
    assert again.chain == made["result"]["chain"]
    assert as_expected(case, again)


def altered(acted: Path, folder: Path, name: str, change: Callable[[str], str] | None) -> Path:
    """Copy what `hil from-run` reads, with one file changed or removed."""
    for each in ("run.toml", "results.json", "truth.csv", "run.desk", FAULT_RECORD):
        text = (acted / each).read_text()
        if each != name:
            (folder / each).write_text(text)
        elif change is not None:
            (folder / each).write_text(change(text))
    return folder


@pytest.mark.parametrize(
    ("name", "change", "text"),
    [
        ("run.toml", lambda text: text.replace('"florence"', '"florens"'), "florens"),
        ("run.toml", lambda text: text.replace("seed", "sed"), "options.seed"),
        ("run.toml", lambda text: text.replace("[options]", "[option]"), "options: missing"),
        ("run.toml", lambda text: text.replace("= 6.0", "= = 6"), "run.toml"),
        ("run.toml", lambda text: text.replace('"browser"', '"external"'), "recorded no desk"),
        ("run.toml", lambda text: text.replace("logs = true", "train = 1"), "options.train"),
        ("run.toml", None, "run.toml"),
        ("results.json", None, "did not end in good order"),
        ("results.json", lambda text: text[:40], "results.json: cannot be read"),
        ("results.json", lambda text: text.replace("frame_log", "log"), "frame_log_sha256"),
        ("truth.csv", None, "truth.csv: missing"),
        ("truth.csv", lambda text: text.splitlines()[0], "no rows"),
        ("run.desk", None, "run.desk: no such file"),
        (FAULT_RECORD, lambda text: text.replace("door_opens", "door_open"), "fault[4].kind"),
    ],
)
def test_a_run_that_cannot_be_replayed_gets_one_line(
    name: str,
    change: Callable[[str], str] | None,
    text: str,
    acted: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run = altered(acted, tmp_path, name, change)
    assert hil(["from-run", str(run), "--out", str(tmp_path / "made")]) == 2

    (line,) = capsys.readouterr().err.splitlines()
    assert text in line
    assert str(run / name) in line
    assert not (tmp_path / "made").exists()


def test_a_run_without_acts_is_refused(
    acted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = altered(acted, tmp_path, FAULT_RECORD, lambda text: "fault = []\n")
    desk = (run / "run.desk").read_text().splitlines()
    (run / "run.desk").write_text("\n".join(desk[:2]))
    assert hil(["from-run", str(run)]) == 2

    assert f"{run}: no acts by hand; a run with --allow-faults" in capsys.readouterr().err


class StoppedWall:
    """A wall clock that only waiting moves."""

    epoch_offset_ns = 0

    def __init__(self) -> None:
        self.instant_ns = 5_000_000_000

    def now_ns(self) -> int:
        return self.instant_ns

    def epoch_ns(self) -> int:
        return self.instant_ns

    def wait_until(self, instant_ns: int) -> None:
        self.instant_ns = max(self.instant_ns, instant_ns)


def test_virtual_time_keeps_to_real_time_and_makes_up_no_long_stop() -> None:
    wall, flushed = StoppedWall(), list[int]()
    pace = RealPace(wall, lambda: flushed.append(wall.instant_ns))
    for step in range(10):
        pace(step * 10_000_000)
    in_step = wall.instant_ns
    wall.instant_ns += 100_000_000
    pace(100_000_000)
    late = wall.instant_ns
    wall.instant_ns += 3_000_000_000
    pace(110_000_000)
    stopped = wall.instant_ns
    pace(120_000_000)

    assert in_step == 5_090_000_000
    assert late == 5_190_000_000, "a short delay is made up"
    assert stopped == 8_190_000_000
    assert wall.instant_ns == 8_200_000_000
    assert len(flushed) == 2
