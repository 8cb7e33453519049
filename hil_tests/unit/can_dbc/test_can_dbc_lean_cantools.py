"""Programs start without the modules that only cantools' tester needs; its users get them on
demand."""

import json
import subprocess
import sys

import pytest

HEAVY = ("can", "asammdf", "pandas", "cantools.tester")
ASK = """\
import json, sys
import {module}
import cantools
loaded = {{name for name, module in sys.modules.items() if hasattr(module, "__file__")}}
before = sorted(loaded.intersection({heavy!r}))
from cantools.tester import Tester
import cantools.tester as tester
same = tester.Tester is Tester and cantools.tester.Tester is Tester
print(json.dumps([before, Tester.__name__, same]))
"""


def output_of(text: str) -> object:
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    "module",
    ["vobc.cli", "plant_emulator.cli.command", "metro_hil.run.lockstep", "canlog.verdict"],
)
def test_the_testers_modules_are_loaded_only_on_demand(module: str) -> None:
    assert output_of(ASK.format(module=module, heavy=HEAVY)) == [[], "Tester", True]


def test_the_placeholder_names_a_missing_attribute() -> None:
    text = (
        "import can_dbc, json, cantools.tester as tester\n"
        "print(json.dumps([hasattr(tester, 'nothing'), hasattr(tester, '__nothing__')]))"
    )

    assert output_of(text) == [False, False]


def test_an_already_loaded_tester_stays() -> None:
    text = (
        "import cantools.tester as tester, can_dbc, json, sys\n"
        "print(json.dumps(sys.modules['cantools.tester'] is tester))"
    )

    assert output_of(text) is True
