"""A controller that is started as `python …` runs with the Python of the bench."""

import shutil
import sys
from pathlib import Path

from metro_hil.external_controller.programs import program_of
from metro_hil.model.case import ControllerSpec
from metro_hil.model.subprocesses import with_own_python


def test_python_in_a_command_is_the_python_of_the_bench() -> None:
    program = program_of(ControllerSpec(kind="command", command="python controller.py"))

    found = shutil.which("python", path=program.environment["PATH"])

    assert found is not None
    assert Path(found).parent == Path(sys.executable).parent


def test_other_programs_are_found_as_before() -> None:
    environment = with_own_python({"PATH": "/usr/one:/usr/two", "LANG": "C"})

    assert environment["PATH"].endswith(":/usr/one:/usr/two")
    assert environment["LANG"] == "C"
