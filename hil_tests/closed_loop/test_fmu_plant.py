"""FMUs of FMI 3.0 and 2.0 as plants, built here from C source."""

import os
import re
import shutil
import subprocess
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import pytest
from fmpy import platform, sharedLibraryExtension

from can_dbc.codec import Decoder
from can_dbc.diagnostics import HEARTBEATS, NodeState
from can_dbc.energy import LineSupply
from can_dbc.nodes import Node
from firmware_py.settings import SettingsError
from metro_hil.foreign_plant.choice import table_of
from metro_hil.foreign_plant.fmu import FmuError
from metro_hil.foreign_plant.fmu_plant import FmuPlant
from metro_hil.model.case import Case, CaseResult, PlantSpec, Setup, Verdict
from metro_hil.run.case import run_alone
from plant_emulator.foreign import INPUTS
from plant_emulator.world import STEP_NS, plan_scenario

ROOT: Final = Path(__file__).parents[2]
EXAMPLES: Final = ROOT / "docs" / "examples"
FMI2: Final = """\
#include "train.c"
const char *fmi2GetVersion(void) { return "2.0"; }
const char *fmi2GetTypesPlatform(void) { return "default"; }
void *fmi2Instantiate(const char *name, int type, const char *guid, const char *place,
                      const void *callbacks, int visible, int logging) {
    return calloc(1, sizeof(Train));
}
void fmi2FreeInstance(void *train) { free(train); }
int fmi2SetupExperiment(void *train, int tolerant, double tolerance, double start, int ends,
                        double end) { return OK; }
int fmi2EnterInitializationMode(void *train) {
    return fmi3EnterInitializationMode(train, 0, 0.0, 0.0, 0, 0.0);
}
int fmi2ExitInitializationMode(void *train) { return OK; }
int fmi2SetReal(void *train, const uint32_t *references, size_t count, const double *values) {
    return fmi3SetFloat64(train, references, count, values, count);
}
int fmi2GetReal(void *train, const uint32_t *references, size_t count, double *values) {
    return fmi3GetFloat64(train, references, count, values, count);
}
int fmi2DoStep(void *train, double from, double step_s, int no_set) {
    step(train, step_s);
    return ((Train *)train)->value[TIME] > 100.0 ? ERROR : OK;
}
#define NONE(name) int fmi2##name(void) { return ERROR; }
"""
"""The train of the example behind the functions of FMI 2.0; it refuses to go beyond 100 s."""
UNUSED: Final = """\
    SetDebugLogging Terminate Reset GetInteger GetBoolean GetString SetInteger SetBoolean SetString
    GetFMUstate SetFMUstate FreeFMUstate SerializedFMUstateSize SerializeFMUstate
    DeSerializeFMUstate GetDirectionalDerivative SetRealInputDerivatives GetRealOutputDerivatives
    CancelStep GetStatus GetRealStatus GetIntegerStatus GetBooleanStatus GetStringStatus
"""
HVB: Final = """
voltage_v = "750 + body.v"
[frames.LINE_SUPPLY]
line_voltage_v = "750 + body.v"
line_current_a = 10
breaker_closed = 1
[frames.ENERGY_METER]
drawn_kwh = 0
regenerated_kwh = 0
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, c_compiler: str) -> Path:
    """The example with its FMU as `train.fmu`, and the same of FMI 2.0 as `old.fmu`."""
    made = tmp_path_factory.mktemp("fmu") / "example"
    shutil.copytree(EXAMPLES / "fmu", made)
    subprocess.run(
        ["sh", "make_fmu.sh"], cwd=made, check=True, env={**os.environ, "CC": c_compiler}
    )
    (made / "old.c").write_text(FMI2 + "".join(f"NONE({name})\n" for name in UNUSED.split()))
    library = made / "train.so"
    command = [c_compiler, "-w", "-O2", "-fPIC", "-shared", "-o", str(library), "old.c", "-lm"]
    subprocess.run(command, cwd=made, check=True)
    with zipfile.ZipFile(made / "old.fmu", "w") as old:
        old.write(library, f"binaries/{platform}/train{sharedLibraryExtension}")
        old.writestr("modelDescription.xml", older((made / "modelDescription.xml").read_text()))
    text = (made / "train.toml").read_text()
    (made / "old.toml").write_text(text.replace("train.fmu", "old.fmu"))
    return made


def older(text: str) -> str:
    """The model description as FMI 2.0 has it."""
    head = (
        '<fmiModelDescription fmiVersion="2.0" modelName="train" guid="metro-train-1">'
        '<CoSimulation modelIdentifier="train"/><ModelVariables>'
    )
    variables = "".join(
        f'<ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}" '
        f'variability="{variability}"><Real{start}/></ScalarVariable>'
        for name, reference, causality, variability, start in re.findall(
            r'<Float64 name="(\S+)" valueReference="(\d+)" causality="(\w+)" '
            r'variability="(\w+)"(?: initial="\w+")?( start="\d+")? ',
            text,
        )
    )
    outputs = "".join(f'<Unknown index="{index}"/>' for index in (11, 12, 13))
    structure = f"<Outputs>{outputs}</Outputs><InitialUnknowns>{outputs}</InitialUnknowns>"
    tail = f"<ModelStructure>{structure}</ModelStructure></fmiModelDescription>"
    return f"{head}{variables}</ModelVariables>{tail}"


def ride(plant: PlantSpec) -> CaseResult:
    setup = Setup(start="II", end="III", duration_s=2.5)
    return run_alone(Case(id="x", index=0, scenario="x", seed=4, setup=setup, plant=plant))


def plant_of(mapping: Path, **changes: float) -> FmuPlant:
    told = table_of(plan_scenario(start="II", end="III"))
    told["train"].update(changes)
    return FmuPlant(mapping, told)


def pulled(plant: FmuPlant, force_n: float, steps: int) -> list[Mapping[str, float]]:
    inputs = {**dict.fromkeys(INPUTS, 0.0), "drive_n": force_n}
    return [plant.step(number * STEP_NS, inputs, [])[0] for number in range(1, steps + 1)]


def test_the_fmu_and_the_program_of_the_examples_compute_the_same_numbers(folder: Path) -> None:
    told = table_of(plan_scenario(start="II", end="III"))
    source = (EXAMPLES / "plant" / "point_mass.py").read_text()
    program: dict[str, Any] = {}
    exec(source.partition("def answer")[0], program)  # noqa: S102 - the example itself
    train, plant = program["PointMass"](told), FmuPlant(folder / "train.toml", told)

    for number in range(1, 401):
        braking = number % 100 > 60
        inputs = dict.fromkeys(INPUTS, 0.0) | {
            "drive_n": 0.0 if braking else 2.0e5,
            "motor_brake_n": 1.5e5 if braking else 0.0,
            "trailer_brake_n": 1.0e5 if braking else 0.0,
            "gradient_permille": number / 40.0,
        }
        assert plant.step(number * STEP_NS, inputs, []) == (train.step(inputs), [], [])
    plant.close()


def test_a_ride_on_an_fmu_is_run_and_judged(folder: Path) -> None:
    result = ride(PlantSpec(kind="fmu", mapping=str(folder / "train.toml")))

    assert result.sim_s == 2.5
    assert result.verdict is not Verdict.BLOCKED
    assert result.measures["front_end_m"] == pytest.approx(3000.0, abs=0.1)


@pytest.mark.parametrize("mapping", ["train.toml", "old.toml"])
def test_an_fmu_of_either_version_follows_newton(folder: Path, mapping: str) -> None:
    """Without resistance 100 kN give 200 t an acceleration of 0.5 m/s²."""
    free = {"resistance_n": 0.0, "resistance_n_per_mps": 0.0, "resistance_n_per_mps2": 0.0}
    plant = plant_of(folder / mapping, mass_kg=2.0e5, inertia_kg=2.0e5, **free)

    truth = pulled(plant, 1.0e5, 100)
    plant.close()

    assert truth[-1]["speed_mps"] == pytest.approx(0.5)
    assert truth[-1]["front_m"] == pytest.approx(3000.0 + 0.25)
    assert truth[-1]["accel_mps2"] == pytest.approx(0.5)


def test_a_small_speed_counts_as_standstill(folder: Path) -> None:
    path = folder / "standing.toml"
    path.write_text("standstill_mps = 0.05\n" + (folder / "train.toml").read_text())
    plant = plant_of(path)

    speeds_mps = [each["speed_mps"] for each in pulled(plant, 1.0e5, 50)]
    plant.close()

    assert speeds_mps[0] == 0.0
    assert min(filter(None, speeds_mps)) > 0.05


def test_the_nodes_of_an_fmu_send_their_frames_at_their_periods(folder: Path) -> None:
    text = (folder / "train.toml").read_text()
    path = folder / "nodes.toml"
    path.write_text(text.replace('["motion"]', '["motion", "HVB"]') + HVB)
    plant = plant_of(path)
    decoder = Decoder([LineSupply, HEARTBEATS[Node.HVB]])
    inputs: dict[str, Any] = dict.fromkeys(INPUTS, 0.0)

    heard = []
    for number in range(1, 201):
        _, frames, _ = plant.step(number * STEP_NS, inputs, [])
        for can_id, data in frames:
            heard.append(decoder.decode(can_id, bytes.fromhex(data), number * STEP_NS))
    plant.close()

    supplies = [each for each in heard if isinstance(each, LineSupply)]
    beats = [each for each in heard if isinstance(each, HEARTBEATS[Node.HVB])]
    assert len(supplies) == 2000 // 100
    assert supplies[-1] == LineSupply(750.0, 10.0, True)
    assert [each.state for each in beats] == [NodeState.BOOT_UP, NodeState.OPERATIONAL]
    assert not decoder.rejections


def test_an_fmu_that_refuses_a_call_names_it(folder: Path) -> None:
    plant = plant_of(folder / "old.toml")

    with pytest.raises(FmuError, match=r"old\.fmu: doStep: .*error"):
        plant.step(101_000_000_000, dict.fromkeys(INPUTS, 0.0), [])
    plant.close()


def test_a_mapping_without_its_fmu_is_named(folder: Path) -> None:
    path = folder / "lost.toml"
    path.write_text((folder / "train.toml").read_text().replace("train.fmu", "lost.fmu"))

    with pytest.raises(SettingsError, match=r"lost\.fmu: no such FMU"):
        plant_of(path)


def test_a_file_that_is_no_fmu_is_named(folder: Path) -> None:
    (folder / "empty.fmu").write_bytes(b"")
    path = folder / "empty.toml"
    path.write_text((folder / "train.toml").read_text().replace("train.fmu", "empty.fmu"))

    with pytest.raises(SettingsError, match=r"empty\.fmu: no valid FMU"):
        plant_of(path)


def test_a_library_that_cannot_be_loaded_is_named(folder: Path) -> None:
    with zipfile.ZipFile(folder / "bare.fmu", "w") as bare:
        bare.write(folder / "modelDescription.xml", "modelDescription.xml")
    path = folder / "bare.toml"
    path.write_text((folder / "train.toml").read_text().replace("train.fmu", "bare.fmu"))

    with pytest.raises(SettingsError, match="cannot be loaded: Cannot find shared library"):
        plant_of(path)
