"""The import contracts exist, hold, and cover every package."""

import configparser
import subprocess
import sys
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
PACKAGES: Final = {
    *("can_dbc", "zenoh_config", "firmware_py"),
    *("vobc", "plant_emulator", "metro_hil", "metro_tools", "canlog"),
}


def contracts() -> configparser.ConfigParser:
    parser = configparser.ConfigParser()
    parser.read(ROOT / ".importlinter", encoding="utf-8")
    return parser


def test_the_import_contracts_hold() -> None:
    linter = Path(sys.executable).with_name("lint-imports")

    done = subprocess.run(
        [str(linter), "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False
    )

    assert done.returncode == 0, done.stdout[-4000:]
    assert " kept, 0 broken" in done.stdout


def test_the_contracts_cover_every_package() -> None:
    assert set(contracts()["importlinter"]["root_packages"].split()) == PACKAGES


def test_no_layer_is_optional() -> None:
    """Parentheses would make a module optional; every existing module must be there."""
    for name, section in contracts().items():
        assert "(" not in section.get("layers", ""), name


def test_all_deciding_code_is_covered_by_the_purity_contract() -> None:
    pure = set(contracts()["importlinter:contract:pure"]["source_modules"].split())

    decides = {"can_dbc", "zenoh_config"}
    for package, touching in (
        ("vobc", {"__init__", "__main__", "cli", "process"}),
        ("plant_emulator", {"__init__", "__main__", "entry", "cli", "process"}),
    ):
        for entry in (ROOT / package).iterdir():
            if entry.stem not in touching and (
                entry.suffix == ".py" or (entry / "__init__.py").exists()
            ):
                decides.add(f"{package}.{entry.stem}")
    assert decides - pure == set()
