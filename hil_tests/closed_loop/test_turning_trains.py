"""Two whole trains on one network: they enter, wait for each other, turn round, and leave."""

import json
from pathlib import Path
from typing import Final

import pytest

from metro_hil.campaign.plan import plan_cases
from metro_hil.campaign.read import read_campaign
from metro_hil.cli import vobc_run
from metro_hil.line.turning.conductor import Conductor
from metro_hil.line.turning.plan import plan_fleet
from metro_hil.model.case import Verdict
from metro_hil.model.run_options import EXIT_OK, parse
from metro_hil.run.dispatch import run_case

NETWORK: Final = """
name = "stub"
buffer_stops = ["yard.end", "tail.start", "exit.end"]
routes = [
    { name = "in", legs = ["yard down", "tail down"] },
    { name = "out", legs = ["tail up", "exit up"] },
]
switches = [{ name = "W1", tip = "tail.end", left = "yard.start", right = "exit.start" }]

[[tracks]]
name = "yard"
start_m = 0.0
end_m = 130.0
limits = [{ start_m = 0.0, end_m = 130.0, limit_mps = 12.0 }]
platforms = [
    { station = "Yard", start_m = 35.0, end_m = 125.0, side = "none", stop_down_m = 40.0 },
]

[[tracks]]
name = "tail"
start_m = 0.0
end_m = 110.0
limits = [{ start_m = 0.0, end_m = 110.0, limit_mps = 12.0 }]
platforms = [
    { station = "Tail", start_m = 15.0, end_m = 105.0, side = "none", STOPS_IN },
]
TAGS_IN
[[tracks]]
name = "exit"
start_m = 0.0
end_m = 120.0
limits = [{ start_m = 0.0, end_m = 120.0, limit_mps = 12.0 }]
platforms = [
    { station = "Exit", start_m = 5.0, end_m = 105.0, side = "none", stop_up_m = 90.0 },
]
TAGS_OUT"""
SERVICE: Final = """
line = "stub.toml"
trains = 2
[[trips]]
route = "in"
[[trips]]
route = "out"
"""
SUPPLY: Final = """
name = "stub"
substations = [{ joint = "a", no_load_v = 836.0, source_ohm = 0.015 }]
sections = [{ begin = "a", end = "b", begin_m = -120.0, end_m = 140.0, ohm_per_km = 0.02 }]
"""


def tags(first_id: int, station: str, stop_m: float, direction: str) -> str:
    sign = -1.0 if direction == "up" else 1.0
    places = {"t1": 52.0, "t2": 12.0, "t3": 3.5, "stop": 2.0}
    rows = sorted((stop_m + sign * by_m, kind) for kind, by_m in places.items())
    return "\n".join(
        f'[[tracks.tags]]\ntag_id = {number}\nposition_m = {at_m}\nkind = "{kind}"\n'
        f'station = "{station}"\ndirection = "{direction}"\n'
        for number, (at_m, kind) in enumerate(rows, first_id)
    )


def write(folder: Path, service: str = SERVICE) -> str:
    network = NETWORK.replace("STOPS_IN", "stop_down_m = 20.0, stop_up_m = 90.0")
    network = network.replace('side = "none"', 'side = "none", dwell_s = 0.0')
    network = network.replace("TAGS_IN", tags(1, "Tail", 20.0, "down"))
    network = network.replace("TAGS_OUT", tags(11, "Exit", 90.0, "up"))
    (folder / "stub.toml").write_text(network, encoding="utf-8")
    (folder / "service.toml").write_text(service, encoding="utf-8")
    return str(folder / "service.toml")


def conducted(folder: Path, *options: str) -> Conductor:
    plan = plan_fleet(parse(["run", "--lockstep", "--service", write(folder), *options]))
    return Conductor(plan, lambda number: None)


def test_a_train_waits_until_the_other_has_turned(tmp_path: Path) -> None:
    conductor = conducted(tmp_path)
    first, second = conductor.trains

    record = conductor.run(interrupted=lambda: len(first.trips) == 2 and first.moving)

    assert record.exit_reason == "interrupted"
    came, leaves = first.trips
    assert came.stops[0].error_m == pytest.approx(0.0, abs=0.1)
    assert leaves.turned
    assert leaves.began_s == came.ended_s
    # The second train entered behind the first, and ran up to the signal 20 m before the switch.
    assert second.trips[0].began_s == pytest.approx(came.clear_s, abs=10.0)
    (waits,) = second.trips
    assert waits.left_s is not None
    assert waits.entered_s is None
    assert waits.hindered
    assert not came.hindered
    assert conductor.between.checked_count > 100
    assert conductor.between.violations == []
    assert first.brakes == second.brakes == []


def test_the_command_prints_the_energy_of_trains_on_a_supply_network(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    supply, out = tmp_path / "supply.toml", tmp_path / "run"
    supply.write_text(SUPPLY, encoding="utf-8")
    one_trip = SERVICE.replace('[[trips]]\nroute = "out"\n', "")
    words = ["--service", write(tmp_path, one_trip), "--trains", "1", "--supply", str(supply)]

    code = vobc_run.main(
        ["run", "--lockstep", *words, "--no-logs", "--hops", "--json", "--out", str(out)]
    )

    printed = capsys.readouterr()
    told = json.loads(printed.out)
    assert code == EXIT_OK
    assert told == json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert (out / "graph.png").read_bytes().startswith(b"\x89PNG")
    assert (told["supply"], told["unconverged"], len(told["trips"])) == ("stub", 0, 1)
    assert "energy balance closes within 0.0000 %" in " ".join(printed.err.split())
    (train,) = told["per_train"]
    assert train["drawn_kwh"] - train["returned_kwh"] + told["lost_kwh"] == pytest.approx(
        told["actual_kwh"]
    )
    motor_kwh = told["traction_kwh"] - train["regenerated_kwh"] + train["resistor_kwh"]
    assert motor_kwh + told["auxiliary_kwh"] == pytest.approx(
        train["drawn_kwh"] - train["returned_kwh"]
    )
    (hop,) = told["hops"]
    assert (hop["from"], hop["to"], hop["runs"]) == ("Yard", "Tail", 1)
    assert hop["traction_kwh"] == pytest.approx(told["traction_kwh"], rel=1e-3)
    assert hop["regenerated_kwh"] == pytest.approx(told["regenerated_kwh"], rel=1e-3)
    assert f"{hop['run_s']:.1f}" in printed.err
    assert train["lowest_v"] == told["lowest_v"] < 836.0 < told["highest_v"]


def test_a_train_keeps_its_meter_when_it_changes_ends(tmp_path: Path) -> None:
    """A case counts the energy of each trip once, although the meter goes on."""
    write(tmp_path)
    (tmp_path / "supply.toml").write_text(SUPPLY, encoding="utf-8")
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(
        '[train]\nservice = "service.toml"\ntrains = 1\nsupply = "supply.toml"\n', encoding="utf-8"
    )
    campaign = read_campaign(str(scenario))
    (case,) = plan_cases(campaign)

    result = run_case(case, files={name: tmp_path / name for name in campaign.files})

    measures = result.measures
    assert (measures["arrived_count"], measures["ends_changed_count"]) == (2.0, 1.0)
    solved = next(each for each in result.monitors if each.name == "supply-solved")
    assert solved.verdict is Verdict.PASS
    kwh = {name: value or 0.0 for name, value in measures.items() if name.endswith("_kwh")}
    net_kwh = kwh["energy_drawn_kwh"] - kwh["energy_returned_kwh"]
    # The network itself loses some per cent.
    assert 0.9 * kwh["grid_energy_kwh"] < net_kwh < kwh["grid_energy_kwh"]
    assert 0.0 < kwh["resistor_energy_kwh"] < 0.2 * kwh["grid_energy_kwh"]
