"""Run a command in a throw-away Linux guest that has SocketCAN and a virtual CAN interface."""

import argparse
import os
import platform
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from firmware_py.arguments import words_of
from firmware_py.assertions import require_assertions
from firmware_py.command_line import CommandParser
from metro_tools.guest import machine, packages, plan
from metro_tools.guest.kernels import AUTOMATIC, GuestKernel, booting_line, choose, failure_text
from metro_tools.guest.plan import GuestError, GuestRequest, NoKernelError
from metro_tools.guest.processor import this_processor

EXIT_OUT_OF_TIME: Final = 124
EXIT_NO_GUEST: Final = 125
EXIT_INTERRUPTED: Final = 130
EXIT_BROKEN_PIPE: Final = 141
KERNEL_VARIABLE: Final = "VCAN_GUEST_KERNEL"
GUEST_VARIABLE: Final = "VCAN_GUEST"
"""Variable in the guest's environment by which programs recognise the guest."""
KERNELS: Final = (AUTOMATIC, *(kernel.value for kernel in GuestKernel))
DEFAULT_TIMEOUT_S: Final = 900
DEFAULT_MEMORY_MIB: Final = 2048

NOTES: Final = """\
The guest is Debian's user-mode Linux: a kernel that runs as an ordinary process. It needs neither
root nor KVM. It has the same files, directory and environment, and leaves nothing behind. Files
written below the working directory stay; all other writes go to memory and are lost. The command
runs as root, with a loopback interface as its only network and an empty standard input. Ctrl-C
reaches it.

kernels: stock, the distribution's user-mode Linux; newer, Debian unstable's, which also runs on
processors with AMX; qemu, an emulated PC, about 15 times slower. The processor decides which is
tried first; if it does not boot, the next one is tried. Only qemu has can-isotp.

exit status: that of the command; 2: wrong use; 124: time limit exceeded; 125: no guest, with the
reason on standard error; 126, 127: the command cannot be executed, was not found; 128+N: ended
by signal N.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command in a guest; without a guest, print the reason."""
    require_assertions("vcan-guest")
    top = parser()
    options = top.parse_args(words_of("vcan-guest", argv))
    command = options.command[1:] if options.command[:1] == ["--"] else options.command
    if not command:
        top.error("a command is missing")
    if options.kernel not in KERNELS:  # argparse does not check the default.
        top.error(f"{KERNEL_VARIABLE}={options.kernel}: choose from {', '.join(KERNELS)}")
    try:
        _check_machine()
        status = _run(_request(options, tuple(command)), options)
    except GuestError as error:
        _say(str(error))
        return EXIT_NO_GUEST
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        return EXIT_BROKEN_PIPE
    except OSError as error:
        _say(f"no guest: {error}")
        return EXIT_NO_GUEST
    if status == EXIT_OUT_OF_TIME:
        _say(f"out of time? the limit is {options.timeout} s (--timeout)")
    return status


def _run(request: GuestRequest, options: argparse.Namespace) -> int:
    """Return the command's exit status from the first kernel that boots."""
    choice = choose(options.kernel, this_processor())
    failures: list[tuple[GuestKernel, str]] = []
    for kernel in choice.kernels:
        try:
            memory = machine.find_memory(kernel, options.memory)
            packages.fill_cache(options.cache, kernel, _say)
            reason = _why_not(failures[-1]) if failures else choice.reason
            if not options.quiet:
                _say(booting_line(kernel, packages.release(options.cache, kernel), reason))
            return machine.run(request, options.cache, kernel, memory, verbose=options.verbose)
        except NoKernelError as error:
            failures.append((kernel, str(error)))
    raise GuestError(failure_text(failures))


def _why_not(failure: tuple[GuestKernel, str]) -> str:
    kernel, text = failure
    return f"{kernel.value}: {text.splitlines()[0]}"


def parser() -> argparse.ArgumentParser:
    """The command line of `vcan-guest`."""
    top = CommandParser(
        prog="vcan-guest",
        is_command=True,
        description=__doc__,
        epilog=NOTES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage="vcan-guest [options] COMMAND [ARGUMENT...]",
    )
    top.add_argument("command", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    top.add_argument(
        "--vcan",
        action="append",
        metavar="NAME",
        help="virtual CAN interface to bring up, may be repeated (default: vcan0)",
    )
    top.add_argument("--no-vcan", action="store_true", help="bring up no interface")
    top.add_argument(
        "--write",
        action="append",
        metavar="DIRECTORY",
        help="directory in which changes stay, may be repeated (default: working directory)",
    )
    top.add_argument(
        "--timeout",
        type=_whole_number,
        default=DEFAULT_TIMEOUT_S,
        metavar="S",
        help=f"time limit of the command in seconds, 0 for none (default: {DEFAULT_TIMEOUT_S})",
    )
    top.add_argument(
        "--memory",
        type=_whole_number,
        default=DEFAULT_MEMORY_MIB,
        metavar="MIB",
        help="memory of the guest, allocated on use; less if less is available "
        f"(default: {DEFAULT_MEMORY_MIB})",
    )
    top.add_argument(
        "--cache",
        type=_folder,
        default=packages.default_cache(),
        metavar="DIRECTORY",
        help="folder for the unpacked guest (default: below ~/.cache)",
    )
    top.add_argument(
        "--kernel",
        choices=KERNELS,
        default=os.environ.get(KERNEL_VARIABLE) or AUTOMATIC,
        help=f"kernel to boot (default: ${KERNEL_VARIABLE}, or the one for this processor, and the "
        "next one if that does not boot)",
    )
    top.add_argument("--quiet", action="store_true", help="do not print which kernel boots")
    top.add_argument("--verbose", action="store_true", help="show the kernel's messages at the end")
    return top


def _whole_number(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number")
    return int(text)


def _folder(text: str) -> Path:
    """Return an absolute path, because the guest starts in another directory."""
    return Path(text).absolute()


def _check_machine() -> None:
    """Report at once if this machine cannot run a guest."""
    if os.environ.get(GUEST_VARIABLE):
        raise GuestError("this is a guest already; run the command itself")
    system, processor = platform.system(), platform.machine()
    if system != "Linux" or processor not in ("x86_64", "AMD64"):
        raise GuestError(
            f"this is {system} on {processor}, but user-mode Linux exists for Linux on x86_64 "
            "only. `vcan up` starts an embedded bus, which needs no kernel support"
        )


def _request(options: argparse.Namespace, command: tuple[str, ...]) -> GuestRequest:
    interfaces = () if options.no_vcan else tuple(dict.fromkeys(options.vcan or ["vcan0"]))
    for name in interfaces:
        if fault := plan.interface_name_fault(name):
            raise GuestError(f"--vcan: {fault}")
    umask = os.umask(0)
    os.umask(umask)
    return GuestRequest(
        command=command,
        directory=str(_working_directory()),
        environment=_environment(),
        umask=umask,
        interfaces=interfaces,
        writable=tuple(_writable(path) for path in options.write or [_working_directory()]),
        timeout_s=options.timeout,
        hostname=platform.node(),
        one_stream=os.path.sameopenfile(1, 2),
    )


def _environment() -> dict[str, str]:
    """Return the caller's environment, with the programs of this installation at the end of
    PATH.
    """
    checkout = Path(__file__).resolve().parents[3] / ".venv/bin"
    folders = (os.environ.get("PATH", os.defpath), Path(sys.executable).parent, checkout)
    found = [str(folder) for folder in folders if isinstance(folder, str) or folder.is_dir()]
    return {**os.environ, "PATH": os.pathsep.join(dict.fromkeys(found))}


def _working_directory() -> Path:
    try:
        return Path.cwd()
    except FileNotFoundError:
        raise GuestError("the working directory is gone; change to one that exists") from None


def _writable(directory: str | Path) -> str:
    path = Path(directory).resolve()
    if not path.is_dir():
        raise GuestError(f"--write: {directory}: no such directory")
    if path == Path("/"):
        raise GuestError("all of / cannot be written through; name a directory with --write")
    return str(path)


def _say(text: str) -> None:
    print(f"vcan-guest: {text}", file=sys.stderr, flush=True)
