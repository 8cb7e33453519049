"""Copies of the packages for a mutant: they run the changed file and otherwise the true sources."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from metro_hil.sensitivity import overlay
from metro_hil.sensitivity.mutants import ControllerMutant
from metro_hil.sensitivity.overlay import MUTATED, Overlays

MUTANT = ControllerMutant(
    name="deaf",
    rule="made by hand",
    file="vobc/atp/supervision.py",
    old="return bool(inputs.latched)",
    new="return not inputs.latched",
)


@pytest.fixture(scope="module")
def overlays(tmp_path_factory: pytest.TempPathFactory) -> Overlays:
    return Overlays(tmp_path_factory.mktemp("overlays") / "packages")


def python(environment: dict[str, str], text: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", text],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_worker_of_a_mutant_imports_the_changed_file_and_the_true_rest(
    overlays: Overlays,
) -> None:
    environment = overlays.environment(MUTANT, os.environ)

    done = python(
        environment,
        "import vobc.atp.supervision as changed, metro_hil, inspect\n"
        "from metro_hil.sensitivity.worker_runner import demand_mutated_source\n"
        "demand_mutated_source()\n"
        "print(inspect.getsource(changed.emergency))\n"
        "print(metro_hil.__file__)",
    )

    assert done.returncode == 0, done.stderr
    assert "return not inputs.latched" in done.stdout
    assert str(overlays.true) in done.stdout
    true = (overlays.true / MUTANT.file).read_text(encoding="utf-8")
    assert MUTANT.old in true
    overlays.discard(MUTANT)
    assert not Path(environment["PYTHONPATH"].split(os.pathsep)[0]).exists()


def test_a_worker_refuses_to_run_another_source(overlays: Overlays) -> None:
    environment = overlays.true_environment(os.environ)
    environment[MUTATED] = f"vobc.atp.supervision={overlays.true / 'elsewhere.py'}"

    done = python(
        environment,
        "from metro_hil.sensitivity.worker_runner import demand_mutated_source\n"
        "demand_mutated_source()",
    )

    assert done.returncode != 0
    assert "WrongSourceError: vobc.atp.supervision was imported from" in done.stderr


def test_bytecode_of_the_true_file_is_not_used_for_the_changed_one(
    overlays: Overlays,
) -> None:
    """The changed file has the length of the true one and may have the same second as time
    stamp."""
    same_size = ControllerMutant(
        name="same-size",
        rule="made by hand",
        file="vobc/atp/supervision.py",
        old="return bool(inputs.latched)",
        new="return  not(inputs.latched)",
    )
    assert len(same_size.old) == len(same_size.new)
    python(overlays.true_environment(os.environ), "import vobc.atp.supervision")

    environment = overlays.environment(same_size, os.environ)
    path = Path(environment[MUTATED].partition("=")[2])
    true = overlays.true / same_size.file
    os.utime(path, ns=(true.stat().st_atime_ns, true.stat().st_mtime_ns))
    done = python(
        environment,
        "from types import SimpleNamespace as S\n"
        "from vobc.atp.supervision import emergency\n"
        "print(emergency(S(latched=())))",
    )

    assert done.stdout.strip() == "True", done.stderr


def test_no_compiled_module_is_copied(overlays: Overlays) -> None:
    assert list(overlays.true.rglob("*.so")) == []
    assert overlay.COMPILED == "*.so"


def test_an_environment_names_no_earlier_mutant(overlays: Overlays) -> None:
    environment = overlays.true_environment({MUTATED: "x=y", "HOME": "/nowhere"})

    assert MUTATED not in environment
    assert environment["PYTHONSAFEPATH"] == "1"
    assert environment["HOME"] == "/nowhere"
