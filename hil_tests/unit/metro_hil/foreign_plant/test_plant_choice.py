"""The choice of a plant on the command lines and in campaign files."""

from pathlib import Path

import pytest

from metro_hil.campaign import CampaignError, plan_cases, read_campaign
from metro_hil.engine.choosing import choose
from metro_hil.engine.errors import UsageError
from metro_hil.foreign_plant.choice import read_plant, table_of
from metro_hil.foreign_plant.plant import PlantStartError
from metro_hil.model.case import BenchKind, Case, PlantSpec, Setup, plant_text
from metro_hil.model.run_options import parse
from metro_hil.model.subprocesses import plant_module
from plant_emulator.world import plan_scenario

PROGRAM = PlantSpec(kind="command", command="./train -v")
HEAD = 'title = "x"\n[train]\nend = "I"\n'


def case(bench: BenchKind = BenchKind.LOCKSTEP) -> Case:
    return Case(id="a/s1", index=0, scenario="a", seed=1, setup=Setup(), bench=bench)


def test_a_command_and_a_mapping_file_are_plants() -> None:
    assert read_plant("command:./train -v") == PROGRAM
    assert read_plant("fmu:train.toml") == PlantSpec(kind="fmu", mapping="train.toml")
    assert plant_text(PROGRAM) == "with plant command ./train -v"
    assert plant_text(PlantSpec()) == ""


@pytest.mark.parametrize("text", ["command:", "fmu:", "ours:x", "train.toml", ""])
def test_any_other_text_is_refused(text: str) -> None:
    with pytest.raises(PlantStartError, match="`fmu:MAPPING` or `nodes:FILE` is needed"):
        read_plant(text)


def test_the_chosen_plant_replaces_that_of_every_case() -> None:
    (chosen,) = choose([case()], plant=PROGRAM)

    assert chosen.plant == PROGRAM
    assert choose([case()])[0].plant == PlantSpec()


def test_a_plant_of_ones_own_runs_on_every_bench() -> None:
    (virtual,) = choose([case()], plant=PROGRAM)
    (real,) = choose([case()], bench="processes", plant=PROGRAM)

    assert (virtual.plant, real.plant) == (PROGRAM, PROGRAM)
    assert plant_module(PlantSpec()) == ("plant_emulator",)
    assert plant_module(PROGRAM)[0] == "metro_hil.foreign_plant.realtime"


def test_nodes_run_in_virtual_time_only() -> None:
    nodes = read_plant("nodes:bus.toml")

    assert choose([case()], plant=nodes)[0].plant == nodes
    with pytest.raises(UsageError, match="--plant nodes: needs the bench lockstep"):
        choose([case()], bench="processes", plant=nodes)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--plant", "comand:x", "--lockstep"], "none of auto, none, command:WORDS"),
        (["--plant", "nodes:x"], "--plant nodes: needs --lockstep"),
        (["--plant", "none", "--lockstep"], "not with --lockstep"),
        (["--plant", "fmu:x", "--lockstep", "--trains", "2"], "a single train"),
    ],
)
def test_a_run_refuses_a_plant_that_does_not_fit(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        parse(["run", *words])

    assert complaint in capsys.readouterr().err


def test_a_campaign_file_names_a_plant(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    path.write_text(HEAD + '[plant]\nkind = "fmu"\nmapping = "train.toml"\nlease_s = 2.0\n')

    (planned,) = plan_cases(read_campaign(str(path)))

    assert planned.plant == PlantSpec(kind="fmu", mapping="train.toml", lease_s=2.0)


@pytest.mark.parametrize(
    ("table", "complaint"),
    [
        ('kind = "fmu"', "plant.kind: 'fmu' needs mapping"),
        ('kind = "command"', "plant.kind: 'command' needs command"),
        ('command = "x"', "plant.command: 'x' belongs to kind 'command'"),
        ('kind = "fmu"\nmapping = "x"\nlease_s = 0', "plant.lease_s"),
        ('kynd = "fmu"', "plant.kynd: unknown key; nearest valid key: kind"),
    ],
)
def test_a_wrong_table_is_named(tmp_path: Path, table: str, complaint: str) -> None:
    path = tmp_path / "x.toml"
    path.write_text(f"{HEAD}[plant]\n{table}\n")

    with pytest.raises(CampaignError, match=complaint):
        read_campaign(str(path))


def test_hello_has_the_numbers_of_the_train() -> None:
    """florence4 runs with half its passengers; its Davis formula is for 1 kN of weight."""
    scenario = plan_scenario(start="II", end="III", load_ratio=0.5)

    told = table_of(scenario)

    train = scenario.train
    assert told["front_m"] == scenario.start.stop_m
    assert told["train"]["mass_kg"] == pytest.approx(train.mass_kg)
    rotating = 1.0 + train.rotating_mass_percent / 100.0
    assert told["train"]["inertia_kg"] == pytest.approx(train.mass_kg * rotating)
    weight_kn = train.mass_kg * 9.81 / 1000.0
    assert told["train"]["resistance_n"] == pytest.approx(weight_kn * train.resistance.a_n_per_kn)
