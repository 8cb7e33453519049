"""Programs start without what only cantools' tester needs, and who uses the tester has it whole."""

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


def told(text: str) -> object:
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    "module", ["vobc.cli", "plant_emulator.cli", "metro_hil.cli.hil", "canlog"]
)
def test_a_program_starts_without_what_the_tester_needs_and_has_it_when_asked(module: str) -> None:
    assert told(ASK.format(module=module, heavy=HEAVY)) == [[], "Tester", True]


def test_the_tester_says_what_it_does_not_have() -> None:
    text = (
        "import can_dbc, json, cantools.tester as tester\n"
        "print(json.dumps([hasattr(tester, 'nothing'), hasattr(tester, '__nothing__')]))"
    )

    assert told(text) == [False, False]


def test_a_tester_that_is_there_stays() -> None:
    text = (
        "import cantools.tester as tester, can_dbc, json, sys\n"
        "print(json.dumps(sys.modules['cantools.tester'] is tester))"
    )

    assert told(text) is True
