"""`hil new-controller`: the project builds, and the bench passes its controller as written."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

import msgspec
import pytest

from firmware_py.native.build import compiler
from metro_hil.campaign import plan_cases
from metro_hil.campaign.read import read_campaign
from metro_hil.cli.hil import main
from metro_hil.cli.hil.new_controller import LANGUAGES
from metro_hil.external_controller.project import project_files
from metro_hil.model.case import CaseResult, ConfigTable, ControllerSpec, Verdict
from metro_hil.run.dispatch import run_case

SOME_S = 9.0
"""Simulated time in which the controller leaves the station, s."""
LATE: Final[ConfigTable] = {"kind": "frame_delay", "delay_s": 0.06, "jitter_s": 0.04}

pytestmark = pytest.mark.usefixtures("c_compiler")


def made(folder: Path, lang: str) -> Path:
    assert main(["new-controller", str(folder), "--lang", lang]) == 0
    command = compiler()
    assert command is not None
    flags = ["CFLAGS=-O0 -Wconversion -Werror", "CXXFLAGS=-O0 -Werror", f"CC={' '.join(command)}"]
    subprocess.run(["make", "-s", "-j2", "-C", folder, *flags], check=True)
    return folder / folder.name


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory, c_compiler: str) -> Path:
    return made(tmp_path_factory.mktemp("kit") / "mine-c", "c")


def smoke(command: str, *faults: ConfigTable, duration_s: float = 180.0) -> CaseResult:
    """Run the first case of the campaign smoke with this program."""
    case = plan_cases(read_campaign("smoke"))[0]
    case = msgspec.structs.replace(
        case,
        faults=faults,
        setup=msgspec.structs.replace(case.setup, duration_s=duration_s),
    )
    spec = ControllerSpec(kind="command", command=command)
    return run_case(msgspec.structs.replace(case, controller=spec))


def test_the_controller_in_c_passes(program: Path) -> None:
    result = smoke(shlex.quote(str(program)))

    assert result.verdict is Verdict.PASS, result.reason


def start(*command: str | Path) -> CaseResult:
    """Run the first seconds, in which frames are late for some time."""
    late = {**LATE, "start_s": 5.0, "duration_s": 2.0}
    return smoke(shlex.join(map(str, command)), late, duration_s=SOME_S)


def test_the_reported_place_contains_the_true_one_when_frames_are_late(program: Path) -> None:
    late = {**LATE, "when": "front_m > 3150"}
    result = smoke(shlex.quote(str(program)), late, duration_s=26.0)

    judged = {each.name: each for each in result.monitors}
    assert judged["inv-13-position-interval"].verdict is Verdict.PASS
    assert [fault.began for fault in result.faults] == [True]


@pytest.fixture(scope="module")
def frames(program: Path) -> str:
    """Hash of the frames of the first seconds with the controller in C, with late frames."""
    result = start(program)

    assert result.sim_s == SOME_S
    return result.chain


def test_the_controllers_in_c_and_python_send_the_same_frames(frames: str, tmp_path: Path) -> None:
    assert main(["new-controller", str(tmp_path / "mine"), "--lang", "python"]) == 0

    assert start(sys.executable, tmp_path / "mine/main.py").chain == frames


def test_the_controllers_in_c_and_rust_send_the_same_frames(
    frames: str, tmp_path: Path, rust_compiler: str
) -> None:
    assert main(["new-controller", str(tmp_path / "mine"), "--lang", "rust"]) == 0
    source, built = tmp_path / "mine/src/main.rs", tmp_path / "mine/mine"
    flags = ["--edition", "2021", "-D", "warnings"]
    subprocess.run([rust_compiler, *flags, source, "-o", built], check=True)

    assert start(built).chain == frames


@pytest.mark.parametrize("tool", ["arm-none-eabi-gcc", "qemu-system-arm"])
def test_firmware_says_which_tool_is_missing(tool: str, tmp_path: Path) -> None:
    assert main(["new-controller", str(tmp_path / "mine"), "--target", "cortex-m"]) == 0
    (tmp_path / "tools").mkdir()
    for name in ("make", "sh", "dirname"):
        (tmp_path / "tools" / name).symlink_to(str(shutil.which(name)))
    words = ["make", "-C", "mine"] if tool.endswith("gcc") else ["sh", "mine/board.sh"]

    done = subprocess.run(
        words,
        cwd=tmp_path,
        env={"PATH": str(tmp_path / "tools")},
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode in (2, 127)
    assert tool in done.stderr


def test_the_controller_as_firmware_sends_the_same_frames(
    frames: str, tmp_path: Path, firmware_tools: None
) -> None:
    assert main(["new-controller", str(tmp_path / "mine"), "--target", "cortex-m"]) == 0
    strict = "CFLAGS=-O1 -Wconversion -Werror"
    subprocess.run(["make", "-s", "-C", tmp_path / "mine", strict], check=True)

    assert start(tmp_path / "mine/mine").chain == frames


def test_the_same_text_is_cpp_without_a_warning(tmp_path: Path, cpp_compiler: str) -> None:
    assert main(["new-controller", str(tmp_path / "mine"), "--lang", "cpp"]) == 0

    strict = ["-std=c++17", "-Wall", "-Wextra", "-pedantic", "-Werror", "-fsyntax-only"]
    sources = sorted((tmp_path / "mine").glob("*.cpp"))
    subprocess.run([cpp_compiler, *strict, *sources], check=True)

    assert [path.name for path in sources] == ["controller.cpp", "main.cpp"]


def test_a_program_without_a_bench_says_who_starts_it(program: Path) -> None:
    done = subprocess.run(
        [program], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )

    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "hil run smoke --controller" in done.stderr


@pytest.mark.parametrize(
    ("lang", "target"), [*((lang, "host") for lang in LANGUAGES), ("c", "cortex-m")]
)
def test_no_mark_of_a_template_is_left(lang: str, target: str) -> None:
    for path, text in project_files("mine", lang, target).items():
        assert not re.search(r"@\w+@", text), path


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new-controller", str(tmp_path)]) == 2
    assert main(["new-controller", str(tmp_path / "9lives")]) == 2
    board = ["--target", "cortex-m", "--lang", "rust"]
    assert main(["new-controller", str(tmp_path / "mine"), *board]) == 2

    exists, name, lang = capsys.readouterr().err.splitlines()
    assert exists == f"hil: {tmp_path}: exists; name a new folder"
    assert "'9lives' is no name of a program" in name
    assert lang == "hil: --target cortex-m: needs --lang c, not rust"
    assert not list(tmp_path.iterdir())
