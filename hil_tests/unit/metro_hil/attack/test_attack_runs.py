"""Campaigns of runs by chance: pairs and triples of faults, each on a line of its own."""

from pathlib import Path

import msgspec
import pytest

from firmware_py.trackdb import load_line
from metro_hil.attack.runs import write_attack
from metro_hil.campaign import plan_cases, read_campaign
from metro_hil.cli.hil import main
from metro_hil.model.case import Verdict
from metro_hil.run.dispatch import run_case


def test_a_seed_repeats_a_run_wherever_it_is_in_the_campaign(tmp_path: Path) -> None:
    many = write_attack(tmp_path / "many", 6, 2)
    one = write_attack(tmp_path / "one", 7, 1)

    cases = {case.id: case for case in plan_cases(read_campaign(str(many)))}
    (alone,) = plan_cases(read_campaign(str(one)))

    assert sorted(cases) == [f"attack-{seed}/s{seed}" for seed in (6, 7)]
    assert (cases[alone.id].setup, cases[alone.id].faults) == (alone.setup, alone.faults)
    name = "lines/7.toml"
    assert (one.parent / name).read_bytes() == (many.parent / name).read_bytes()


def test_the_runs_have_two_or_three_faults_of_different_groups_and_steep_lines(
    tmp_path: Path,
) -> None:
    cases = plan_cases(read_campaign(str(write_attack(tmp_path, 1, 6))))

    counts = {len(case.faults) for case in cases}
    lines = [load_line(str(file)) for file in (tmp_path / "lines").glob("*.toml")]

    assert counts == {2, 3}
    assert min(line.start_m for line in lines) < 0.0
    steepest = [max(abs(g.gradient_permille) for g in line.gradients) for line in lines]
    assert max(steepest) > 50.0
    assert min(steepest) > 0.0


def test_a_run_is_judged_by_all_invariants(tmp_path: Path) -> None:
    path = write_attack(tmp_path, 1, 1)
    (case,) = plan_cases(read_campaign(str(path)))
    # The train sets off within this time.
    setup = msgspec.structs.replace(case.setup, duration_s=10.0)
    case = msgspec.structs.replace(case, setup=setup)
    files = {file.name: file for file in path.parent.rglob("*.toml")}

    result = run_case(case, files=files)

    assert result.verdict is Verdict.PASS, result.reason
    assert len(result.monitors) > 20


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--curves", "0", "--runs", "0"), "nothing to try"),
        (("--curves", "3", "--controller", "command:mine"), "judges the shipped protection"),
        (("--controller", "mine"), "none of `shipped`"),
    ],
)
def test_a_contradiction_is_refused_before_anything_is_tried(
    words: tuple[str, ...], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["attack", *words]) == 2

    assert text in capsys.readouterr().err
