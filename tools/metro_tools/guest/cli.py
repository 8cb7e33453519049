"""Run a command in a throw-away Linux guest that has SocketCAN and a virtual CAN interface."""

import argparse
import os
import platform
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from metro_tools.guest import machine, packages, plan
from metro_tools.guest.plan import GuestError, GuestRequest

EXIT_OUT_OF_TIME: Final = 124
EXIT_NO_GUEST: Final = 125
EXIT_INTERRUPTED: Final = 130
EXIT_BROKEN_PIPE: Final = 141
GUEST_VARIABLE: Final = "VCAN_GUEST"
"""Set in the guest's environment, so that a program can tell where it runs."""
DEFAULT_TIMEOUT_S: Final = 900
DEFAULT_MEMORY_MIB: Final = 2048

NOTES: Final = """\
The guest is Debian's user-mode Linux: a kernel that runs as an ordinary process. It needs neither
root nor KVM, sees the same files, directory and environment, and is gone afterwards. What the
command writes below the working directory stays; all other writes go to memory and vanish. The
command is root, has a loopback and no other network, and an empty standard input.
Ctrl-C reaches it.

exit status: the command's; 124: it ran out of time; 125: there was no guest, and why is said on
standard error; 126, 127: the command cannot be executed, was not found; 128+N: ended by signal N.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Parse, ask for the guest, say why not if so."""
    parser = _parser()
    options = parser.parse_args(argv)
    command = options.command[1:] if options.command[:1] == ["--"] else options.command
    if not command:
        parser.error("a command is missing")
    try:
        _check_machine()
        request = _request(options, tuple(command))
        packages.fill_cache(options.cache, _say)
        status = machine.run(request, options.cache, options.memory, verbose=options.verbose)
    except GuestError as error:
        _say(str(error))
        return EXIT_NO_GUEST
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        return EXIT_BROKEN_PIPE
    if status == EXIT_OUT_OF_TIME:
        _say(f"out of time? the limit is {options.timeout} s (--timeout)")
    return status


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="vcan-guest",
        description=__doc__,
        epilog=NOTES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage="vcan-guest [options] COMMAND [ARGUMENT...]",
    )
    parser.add_argument("command", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    parser.add_argument(
        "--vcan",
        action="append",
        metavar="NAME",
        help="virtual CAN interface to bring up, may be repeated (default: vcan0)",
    )
    parser.add_argument("--no-vcan", action="store_true", help="bring up no interface")
    parser.add_argument(
        "--write",
        action="append",
        metavar="DIRECTORY",
        help="a directory whose changes stay, may be repeated (default: the working directory)",
    )
    parser.add_argument(
        "--timeout",
        type=_whole_number,
        default=DEFAULT_TIMEOUT_S,
        metavar="S",
        help=f"seconds that the command may run, 0 for any (default: {DEFAULT_TIMEOUT_S})",
    )
    parser.add_argument(
        "--memory",
        type=_whole_number,
        default=DEFAULT_MEMORY_MIB,
        metavar="MIB",
        help=f"taken as it is used; less if there is less (default: {DEFAULT_MEMORY_MIB})",
    )
    parser.add_argument(
        "--cache",
        type=Path,
        default=packages.default_cache(),
        metavar="DIRECTORY",
        help="where the unpacked guest is kept (default: below ~/.cache)",
    )
    parser.add_argument(
        "--verbose", action="store_true", help="show the kernel's messages at the end"
    )
    return parser


def _whole_number(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number")
    return int(text)


def _check_machine() -> None:
    """Say early what cannot work, in words about this machine."""
    if os.environ.get(GUEST_VARIABLE):
        raise GuestError("this is a guest already; run the command itself")
    system, processor = platform.system(), platform.machine()
    if system != "Linux" or processor not in ("x86_64", "AMD64"):
        raise GuestError(
            f"this is {system} on {processor}, but user-mode Linux exists for Linux on x86_64 "
            "only. `vcan up` gives an embedded bus that needs no kernel support"
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
        directory=str(Path.cwd()),
        environment=_environment(),
        umask=umask,
        interfaces=interfaces,
        writable=tuple(_writable(path) for path in options.write or [Path.cwd()]),
        timeout_s=options.timeout,
        hostname=platform.node(),
        one_stream=os.path.sameopenfile(1, 2),
    )


def _environment() -> dict[str, str]:
    """The caller's, with the programs of this checkout's .venv found after all others."""
    programs = Path(__file__).resolve().parents[3] / ".venv/bin"
    path = os.environ.get("PATH", os.defpath)
    return {**os.environ, "PATH": f"{path}{os.pathsep}{programs}" if programs.is_dir() else path}


def _writable(directory: str | Path) -> str:
    path = Path(directory).resolve()
    if not path.is_dir():
        raise GuestError(f"--write: {directory}: no such directory")
    if path == Path("/"):
        raise GuestError("all of / cannot be written through; name a directory with --write")
    return str(path)


def _say(text: str) -> None:
    print(f"vcan-guest: {text}", file=sys.stderr, flush=True)
