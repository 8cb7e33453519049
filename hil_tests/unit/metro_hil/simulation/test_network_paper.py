"""The literal rules of [Wu 2022] in simulation: each unsafe rule shows its hazard."""

from pathlib import Path

import pytest

from metro_hil.cli.hil import main
from metro_hil.simulation.batch import SeedJournal, Total, run_many
from metro_hil.simulation.checker import ViolationError
from metro_hil.simulation.paper_protocol import PaperNodes, PaperSettings, PaperTrain
from metro_hil.simulation.run import Phases, RunResult
from metro_hil.simulation.simulate import SeedJob
from metro_hil.simulation.world import Setting, SimulatedLine

S = 1_000_000_000
THIRD = 100


def world(fronts_m: dict[int, float]) -> SimulatedLine:
    settings = PaperSettings(tuple(fronts_m), THIRD, 20_000.0, roll_back_m=2.0)
    return SimulatedLine(5, Setting(fronts_m, stops_m=[3000.0]), PaperNodes(settings))


def start(line: SimulatedLine, *addresses: int) -> None:
    """Start trains one after the other, the first long before the second, as the paper assumes."""
    for address in addresses:
        line.net.boot(address)
        line.net.run(line.net.now_ns + 4 * S)


def masters(line: SimulatedLine) -> list[int]:
    found = []
    for address in line.trains:
        machine = line.net.nodes[address].machine
        protocol = getattr(machine, "protocol", None)
        if isinstance(protocol, PaperTrain) and protocol.master:
            found.append(address)
    return found


def test_on_a_perfect_network_the_published_rules_work() -> None:
    line = world({2: 900.0, 1: 300.0})
    start(line, THIRD, 2, 1)
    line.net.run(120 * S)

    assert masters(line) == [2]
    assert line.trains[1].front_m > 900.0
    assert line.trains[1].emergencies == 0


def test_taking_silence_for_a_missing_master_puts_two_trains_on_the_same_metres() -> None:
    line = world({2: 900.0, 1: 300.0})
    line.net.cut([(1, 2), (2, 1)])

    with pytest.raises(ViolationError) as error:
        start(line, THIRD, 2, 1)

    assert error.value.invariant == "21"
    assert "train 1 may go to 20000.00 m" in error.value.what


def test_a_third_party_that_picks_one_of_two_masters_comes_too_late() -> None:
    """The third party receives both and decides at once, but the track was already granted."""
    line = world({2: 900.0, 1: 300.0})
    line.net.cut([(1, 2), (2, 1)])

    with pytest.raises(ViolationError):
        start(line, THIRD, 2, 1)

    assert not line.net.nodes[THIRD].links[1].cut
    assert not line.net.nodes[1].links[THIRD].cut


def test_an_immediate_takeover_from_a_paused_master_makes_two_masters() -> None:
    line = world({2: 900.0, 1: 300.0})
    start(line, THIRD, 2, 1)
    line.net.stop(2, 3 * S)
    line.net.run(line.net.now_ns + 2 * S)

    assert sorted(masters(line)) == [1, 2]


def test_two_that_enter_together_both_command() -> None:
    line = world({2: 900.0, 1: 300.0})
    line.net.boot(1)
    line.net.boot(2)
    line.net.run(2 * S)

    assert sorted(masters(line)) == [1, 2]
    assert line.checker.looked["19 broken"] > 0


def test_an_authority_without_age_is_obeyed_however_old_it_is() -> None:
    line = world({2: 900.0, 1: 300.0})
    start(line, THIRD, 2, 1)
    line.net.cut([(1, 2)])

    with pytest.raises(ViolationError) as error:
        line.net.run(line.net.now_ns + 4 * S)

    assert error.value.invariant == "24"
    assert "train 1 accepts an authority that is" in error.value.what


PAPER = SeedJob(Phases(trouble_s=30.0), protocol="paper")


def test_random_faults_find_the_same_hazard_in_every_process() -> None:
    here = list(run_many(range(1, 7), PAPER, workers=1))
    there = sorted(run_many(range(1, 7), PAPER, workers=2), key=lambda result: result.seed)

    assert sum(bool(result.invariant) for result in here) >= 3
    assert [each.digest for each in here] == [each.digest for each in there]
    assert [each.what for each in here] == [each.what for each in there]


def test_a_broken_seed_names_the_command_that_repeats_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    code = main(["simulate", "--protocol", "paper", "--seeds", "1..3", "--minutes", "0.5"])
    said = capsys.readouterr().out
    assert code == 1
    command = next(line for line in said.splitlines() if "to repeat it: hil" in line)
    words = command.split("to repeat it: hil ")[1].split()

    code = main(words)
    story = capsys.readouterr().out.splitlines()

    assert code == 1
    verdict = next(line for line in story if "verdict" in line)
    assert words[words.index("--seed") + 1] in ("1", "2", "3")
    instants = [float(line.split()[0]) for line in story[: story.index(verdict) + 1]]
    assert instants == sorted(instants)
    assert len(instants) > 5
    assert any("sends" in line for line in story)


def test_a_journal_skips_finished_seeds_and_tolerates_a_torn_last_line(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    journal = SeedJournal(path)
    for result in run_many((1, 2), PAPER, workers=1):
        journal.append(result)
    with path.open("a", encoding="utf-8") as file:
        file.write('{"seed": 3, "dig')

    again = SeedJournal(path)
    again.append(RunResult(seed=9))

    assert [each.seed for each in again.results] == [1, 2]
    assert [each.seed for each in SeedJournal(path).results] == [1, 2, 9]
    total = Total()
    for result in again.results:
        total.add(result)
    assert total.runs == 2
    assert total.events > 0


@pytest.mark.parametrize("kept", [b"first\nsecond", b"{}\n", b"[]", b"\xff\x00\n", b'{"seed"=1'])
def test_a_file_that_is_no_journal_is_refused_and_not_changed(
    kept: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "notes.txt"
    path.write_bytes(kept)

    code = main(["simulate", "--seed", "3", "--minutes", "0.05", "--journal", str(path)])

    assert code == 2
    assert f"hil: --journal {path}:1: " in capsys.readouterr().err
    assert path.read_bytes() == kept


def test_an_unwritable_journal_is_reported_with_the_seed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(journal: SeedJournal, result: RunResult) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(SeedJournal, "append", full)

    code = main(
        ["simulate", "--seed", "3", "--minutes", "0.05", "--journal", str(tmp_path / "j.jsonl")]
    )

    assert code == 3
    assert "seed 3: --journal: No space left on device" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--seeds", "7..3"], "not beyond the last"),
        (["--seeds", "x"], "A..B"),
        (["--minutes", "-1"], "not more than 0"),
        (["--trace", "--workers", "2"], "needs one worker"),
        (["--journal", "/proc/nowhere/x"], "--journal /proc/nowhere/x: No such file"),
        (["--journal", "/proc"], "--journal /proc: Is a directory"),
        (["--timers", "B", "--seed", "1"], "--timers B: seed 1 uses A"),
        (["--timers", "B", "--protocol", "paper"], "the paper's rules have no timers"),
    ],
)
def test_wrong_arguments_get_one_line(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        code = main(["simulate", *words])
    except SystemExit as ended:
        code = int(str(ended.code))

    assert code == 2
    assert complaint in capsys.readouterr().err
