"""The guest as a process: starts it, reads its output, passes signals on, and always ends it."""

import os
import selectors
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import IO, Final

from firmware_py.clock.clock import NS_PER_S, WallClock
from metro_tools.guest import plan
from metro_tools.guest.kernels import GuestKernel
from metro_tools.guest.launch import GuestMemory, Launch, launch, machine_for
from metro_tools.guest.plan import (
    Engine,
    GuestError,
    GuestFolders,
    GuestRequest,
    MemoryPlace,
    NoKernelError,
)
from metro_tools.guest.wires import GuestWires, lay_wires, write_all

BOOT_TIMEOUTS_S: Final = {Engine.UML: 90.0, Engine.QEMU: 300.0}
"""Time limits for booting. One or two seconds are usual, 25 with QEMU; the rest is for a busy
machine."""
HANG_GRACE_S: Final = 60.0
"""Additional time after the command's own limit, which the guest enforces; it detects a hanging
guest."""
SIGNAL_GRACE_S: Final = 20.0
"""Time from a forwarded signal to the end of the guest, in which a run writes its report."""
FLUSH_TIMEOUT_S: Final = 5.0
"""Time for the guest to power off and for its last output."""
WAIT_MAX_S: Final = 60.0
CLOCK: Final = WallClock()
CHUNK_BYTES: Final = 65536
PASSED_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
WATCHDOG: Final = 'read -r _; kill -s KILL -- "-$1"; rm -rf -- "$2"'
"""Shell script that waits for the end of its input, which the launcher keeps open while it
lives."""


@dataclass(slots=True)
class _Course:
    """State of the guest's run."""

    is_up: bool = False
    status: int | None = None
    signals: list[int] = field(default_factory=list)
    """Received signals that have not been passed on yet."""
    deadline_s: float = 0.0
    why: str = "did not come up"
    """Message when the deadline passes."""


def find_memory(kernel: GuestKernel, wanted_mib: int) -> GuestMemory:
    """Return location and size of the guest's memory.

    Raises:
        NoKernelError: there is no room for it.
    """
    if kernel is GuestKernel.QEMU:
        return GuestMemory(None, plan.emulated_memory_mib(_available_mib(), wanted_mib))
    place, memory_mib = plan.choose_memory(memory_places(), wanted_mib)
    return GuestMemory(place.path, memory_mib)


def run(
    request: GuestRequest, cache: Path, kernel: GuestKernel, memory: GuestMemory, *, verbose: bool
) -> int:
    """Boot, run, power off, and return the command's exit status.

    Raises:
        NoKernelError: the guest did not boot; with its last messages.
        GuestError: it hung or crashed later.
    """
    with _run_dir() as run_dir:
        machine = machine_for(kernel, cache, run_dir)
        _write_scripts(request, machine, run_dir)
        try:
            return _boot(request, machine, memory)
        except GuestError as error:
            raise type(error)(f"{error}\n{_last_messages(run_dir)}") from error
        finally:
            if verbose:
                text = (run_dir / "console.log").read_text(errors="replace")
                print(text, file=sys.stderr, flush=True)


def memory_places() -> Iterator[MemoryPlace]:
    """File systems that could hold the guest's memory, best first."""
    kinds = {}
    for line in Path("/proc/mounts").read_text(errors="replace").splitlines():
        _, mount_point, kind, *_ = line.split()
        kinds[mount_point] = kind
    for path in ("/dev/shm", os.environ.get("XDG_RUNTIME_DIR", ""), "/tmp", "/run/shm"):  # noqa: S108
        if path and path in kinds and os.access(path, os.W_OK):
            state = os.statvfs(path)
            yield MemoryPlace(
                path=path,
                kind=kinds[path],
                executable=not state.f_flag & os.ST_NOEXEC,
                free_mib=state.f_bavail * state.f_frsize // plan.MIB,
            )


def _available_mib() -> int:
    words = Path("/proc/meminfo").read_text().split()
    return int(words[words.index("MemAvailable:") + 1]) // 1024


@contextmanager
def _run_dir() -> Iterator[Path]:
    # Directly in /tmp, because the path is part of the kernel's command line, where a blank would
    # end it.
    path = Path(tempfile.mkdtemp(prefix="vcan-guest.", dir="/tmp"))
    try:
        yield path
    finally:
        shutil.rmtree(path, ignore_errors=True)


def _write_scripts(request: GuestRequest, machine: GuestFolders, run_dir: Path) -> None:
    timeout_program = shutil.which("timeout")
    if timeout_program is None:
        raise GuestError("the program timeout (package coreutils) is missing")
    busybox = run_dir / "busybox"
    shutil.copy2(machine.busybox, busybox)
    (run_dir / "mnt").mkdir()
    command = plan.command_script(request, machine.engine, str(busybox), timeout_program)
    _write(run_dir / "writable", plan.writable_list(request))
    _write(run_dir / "command", command)
    source = Path(__file__).with_name("init.sh").read_text()
    init = run_dir / "init"
    _write(init, f"#!{busybox} sh\n{plan.settings_script(request, machine)}{source}")
    init.chmod(0o700)


def _write(path: Path, text: str) -> None:
    """Write text byte for byte; the environment need not be UTF-8."""
    path.write_bytes(os.fsencode(text))


def _boot(request: GuestRequest, machine: GuestFolders, memory: GuestMemory) -> int:
    wires = lay_wires(one_stream=request.one_stream)
    start = launch(machine, memory, wires)
    with (Path(machine.run_dir) / "console.log").open("wb") as console, _kept_signals() as caught:
        caught.deadline_s = _now_s() + BOOT_TIMEOUTS_S[machine.engine]
        process = _start(start, machine, wires, console)
        try:
            with _watched(process, str(machine.run_dir)):
                return _attend(process, wires, request.timeout_s, caught)
        finally:
            _end(process)
            for descriptor in wires.launcher_ends():
                os.close(descriptor)


def _start(
    start: Launch, machine: GuestFolders, wires: GuestWires, console: IO[bytes]
) -> subprocess.Popen[bytes]:
    """Start the kernel as leader of its own session, so that Ctrl-C does not reach it."""
    try:
        process = subprocess.Popen(  # noqa: S603 # the kernel from the cache
            start.words,
            cwd=Path(machine.kernel).parent,
            env={**os.environ, **start.settings},
            stdin=subprocess.DEVNULL,
            stdout=console,
            stderr=console,
            pass_fds=wires.guest_ends(),
            start_new_session=True,
        )
    except OSError as error:
        raise NoKernelError(f"cannot start {start.words[0]}: {error.strerror}") from error
    finally:
        for descriptor in wires.guest_ends():
            os.close(descriptor)
    return process


@contextmanager
def _watched(process: subprocess.Popen[bytes], run_dir: str) -> Iterator[None]:
    """End the guest's processes even if the launcher is killed.

    All must be killed at once: if only the guest's kernel died, its remaining processes would
    continue on the host.
    """
    with subprocess.Popen(  # noqa: S603 # a fixed script and a number
        ["sh", "-c", WATCHDOG, "sh", str(process.pid), run_dir],  # noqa: S607 # whichever shell there is
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    ) as watchdog:
        try:
            yield
        finally:
            watchdog.kill()


def _now_s() -> float:
    return CLOCK.now_ns() / NS_PER_S


@contextmanager
def _kept_signals() -> Iterator[_Course]:
    """Record the signals that would end the launcher, to pass them on instead."""
    course = _Course()

    def note(number: int, _frame: FrameType | None) -> None:
        course.signals.append(number)

    before = {number: signal.signal(number, note) for number in PASSED_SIGNALS}
    try:
        yield course
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _attend(
    process: subprocess.Popen[bytes], wires: GuestWires, timeout_s: int, course: _Course
) -> int:
    """Relay output, follow reports and pass signals on until the guest has ended."""
    reports = bytearray()
    with selectors.DefaultSelector() as selector, _wakeup(selector):
        selector.register(wires.reports_in, selectors.EVENT_READ, None)
        for read, _, own in wires.streams:
            selector.register(read, selectors.EVENT_READ, own)
        while len(selector.get_map()) > 1 and (left_s := course.deadline_s - _now_s()) > 0:
            for key, _ in selector.select(min(left_s, WAIT_MAX_S)):
                _take(selector, key, reports)
            _follow(reports, course, timeout_s)
            _pass_signals(course, wires.orders_out)
            if process.poll() is not None:
                # The guest has ended; its pipes close at once unless a stray process of it holds
                # them.
                course.deadline_s = min(course.deadline_s, _now_s() + FLUSH_TIMEOUT_S)
    if course.status is None and not course.is_up:
        raise NoKernelError(f"the guest {course.why}")
    if course.status is None:
        raise GuestError(f"the guest {'crashed' if process.poll() is not None else course.why}")
    return course.status


@contextmanager
def _wakeup(selector: selectors.BaseSelector) -> Iterator[None]:
    """Let a signal end the selector's wait."""
    read, write = os.pipe()
    os.set_blocking(read, False)
    os.set_blocking(write, False)
    before = signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    selector.register(read, selectors.EVENT_READ, read)
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        os.close(read)
        os.close(write)


def _take(selector: selectors.BaseSelector, key: selectors.SelectorKey, reports: bytearray) -> None:
    """Move available data: output to its destination, reports to their buffer."""
    data = os.read(key.fd, CHUNK_BYTES)
    if key.data == key.fd:  # the wake-up pipe
        return
    if not data:
        selector.unregister(key.fd)
    elif key.data is None:
        reports += data
    else:
        write_all(key.data, data)


def _follow(reports: bytearray, course: _Course, timeout_s: int) -> None:
    """Process the complete lines of the reports."""
    while (end := reports.find(b"\n")) >= 0:
        words = bytes(reports[:end]).split()
        del reports[: end + 1]
        if words == [b"up"]:
            course.is_up = True
            course.why = "hung"
            limit_s = timeout_s + HANG_GRACE_S if timeout_s else float("inf")
            course.deadline_s = _now_s() + limit_s
        elif len(words) == 2 and words[0] == b"status":
            course.status = int(words[1])
            course.deadline_s = _now_s() + FLUSH_TIMEOUT_S


def _pass_signals(course: _Course, orders_out: int) -> None:
    """Pass the first signal to the command; a second one ends the launcher at once."""
    while course.signals:
        number = course.signals.pop(0)
        if not course.is_up or course.why == "did not end after a signal":
            raise KeyboardInterrupt
        os.write(orders_out, signal.Signals(number).name.removeprefix("SIG").encode() + b"\n")
        course.why = "did not end after a signal"
        course.deadline_s = min(course.deadline_s, _now_s() + SIGNAL_GRACE_S)


def _end(process: subprocess.Popen[bytes]) -> None:
    """Kill the rest of the guest: the kernel and the host processes of its processes."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _last_messages(run_dir: Path) -> str:
    text = (run_dir / "console.log").read_text(errors="replace").strip()
    lines = text.splitlines()[-15:]
    return "its last messages:\n  " + "\n  ".join(lines) if lines else "it printed nothing"
