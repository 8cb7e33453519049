"""The two sides of the bus as FMUs: the program behind each, and its hello."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from firmware_py import settings
from firmware_py.storage.whole_file import write_whole
from metro_hil.external_controller.choice import memory_of
from metro_hil.fmi_export.export import write_fmu
from metro_hil.model.mission import plan_journey
from metro_hil.model.run_options import RunOptions
from metro_hil.run.lockstep import config_of, scenario_of
from plant_emulator.cli.grant import TRUTH
from plant_emulator.foreign import TRUTH_OF
from vobc.plausible import check_plausible
from vobc.process import Commission

TRAIN_WORDS: Final = ("-m", "plant_emulator.cli.grant")
CONTROLLER_WORDS: Final = ("-m", "vobc", "grant")


def write_train(path: Path, options: RunOptions) -> Sequence[Path]:
    """Write the train with its wayside, and a mapping file with which the bench runs it.

    Raises SettingsError, BuildError and OSError.
    """
    scenario_of(options)
    told = {
        "line": _found(options.line),
        "consist": _found(options.consist),
        "seed": options.seed,
        "start": options.start,
        "end": options.end,
    }
    write_fmu(path, "train", (sys.executable, *TRAIN_WORDS), told, TRUTH)
    mapping = path.with_suffix(".toml")
    write_whole(mapping, _mapping(path.name))
    return path, mapping


def write_controller(path: Path, options: RunOptions) -> Sequence[Path]:
    """Write the controller. Raises SettingsError, BuildError and OSError."""
    journey, config = plan_journey(options), config_of(options)
    check_plausible(config, journey.line)
    memory = memory_of(journey, config)
    told = Commission(config, journey.line, journey.mission, memory, 0).table()
    write_fmu(path, "controller", (sys.executable, *CONTROLLER_WORDS), told)
    return (path,)


def _found(name: str) -> str:
    """The name of a shipped file, or the full path of another one."""
    return str(Path(name).resolve()) if settings.is_path(name) else name


def _mapping(fmu: str) -> str:
    parts = ", ".join(f'"{part}"' for part in TRUTH_OF)
    truth = "".join(f'{name} = "truth.{name}"\n' for name in TRUTH)
    return (
        f"# The exported train as the plant of the bench: `hil run … --plant fmu:FILE`.\n"
        f'fmu = "{fmu}"\nprovides = [{parts}]\nterminal = "CAN"\nserial = "Serial.Tx_Data"\n'
        f"\n[truth]\n{truth}"
    )
