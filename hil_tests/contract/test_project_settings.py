"""Every shipped configuration file is usable, and errors in one are reported by name."""

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import pytest
import tomli_w

from firmware_py.settings import SettingsError, find, shipped_names
from firmware_py.trackdb import load_line
from firmware_py.trackdb.areas import load_areas
from plant_emulator.power.supplies import load_supply
from plant_emulator.traffic.config import load_traffic
from plant_emulator.train_config import load_train
from vobc.config import load_config

ROOT: Final = Path(__file__).resolve().parents[2]
READERS: Final[dict[str, Callable[[str], object]]] = {
    "firmware_py.trackdb": load_line,
    "firmware_py.trackdb.division": load_areas,
    "plant_emulator.consists": load_train,
    "plant_emulator.power": load_supply,
    "plant_emulator.traffic": load_traffic,
    "vobc.params": load_config,
}
SHIPPED: Final = [(package, name) for package in READERS for name in shipped_names(package)]


@pytest.mark.parametrize(("package", "name"), SHIPPED)
def test_a_shipped_file_loads_by_its_stem(package: str, name: str) -> None:
    assert READERS[package](name)


def test_every_toml_file_in_the_packages_has_a_reader() -> None:
    """No test would check a file that no reader knows."""
    known = {find(name, package).resolve() for package, name in SHIPPED}
    packages = {package.partition(".")[0] for package in READERS}

    there = {path.resolve() for package in packages for path in (ROOT / package).rglob("*.toml")}

    assert there == known


@pytest.mark.parametrize(("package", "name"), SHIPPED)
def test_an_unknown_key_is_named_with_its_file(package: str, name: str, tmp_path: Path) -> None:
    table = _shipped_table(package, name)
    path = tmp_path / "wrong.toml"
    path.write_text(tomli_w.dumps({**table, "unheard_of": 1}), encoding="utf-8")

    with pytest.raises(SettingsError, match=r"wrong\.toml.*unheard_of"):
        READERS[package](str(path))


@pytest.mark.parametrize(("package", "name"), SHIPPED)
def test_a_file_without_one_of_its_top_keys_is_refused_or_complete(
    package: str, name: str, tmp_path: Path
) -> None:
    """A missing key is either named or has a default; no other result is permitted."""
    table = _shipped_table(package, name)
    refusals: dict[str, str] = {}
    for key in table:
        path = tmp_path / "short.toml"
        rest = {other: value for other, value in table.items() if other != key}
        path.write_text(tomli_w.dumps(rest), encoding="utf-8")
        try:
            READERS[package](str(path))
        except SettingsError as error:
            refusals[key] = str(error)

    assert refusals
    for key, text in refusals.items():
        assert "short.toml" in text
        assert key in text


def _shipped_table(package: str, name: str) -> dict[str, Any]:
    return tomllib.loads(find(name, package).read_text(encoding="utf-8"))
