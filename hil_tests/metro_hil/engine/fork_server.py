"""A fork server: imports once what a worker needs, and forks all workers of a pool.

A fork takes milliseconds; a process that imports for itself takes half a second. The pool sends
pipes over a Unix socket, and the fork that receives them answers on them as a worker.
"""

import argparse
import contextlib
import gc
import importlib
import os
import signal
import socket
import struct
import subprocess
import sys
import tempfile
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Final

from firmware_py.assertions import require_assertions
from firmware_py.clock.realtime import die_with_parent
from metro_hil.engine.worker import serve
from metro_hil.model.gc_tuning import collect_rarely

FORK: Final = 0
"""Request for a fork; any other request is a process id, and asks for its exit status."""
REQUEST: Final = struct.Struct("<q")
REPLY: Final = struct.Struct("<qq")
"""Process id and exit status. A fork has none yet, so it is 0."""
PIPES: Final = 3
"""Files that come with a request for a fork: input, output and standard error."""
END_S: Final = 2.0
"""How long workers get to end by themselves once their input is closed, s."""


class ForkServer:
    """The pool's side: the process of the server, and its requests."""

    def __init__(self, runner: str, environment: Mapping[str, str], nice: int) -> None:
        """Raises OSError if no process can be started.

        Args:
            runner: `module:function`; the server imports the module.
        """
        self.stderr = tempfile.TemporaryFile()  # noqa: SIM115
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            # The server has its own session: Ctrl-C reaches the master only.
            self.process = subprocess.Popen(
                [
                    *(sys.executable, "-m", "metro_hil.engine.fork_server"),
                    *("--parent", str(os.getpid()), "--nice", str(nice)),
                    *("--runner", runner, "--socket", str(theirs.fileno())),
                ],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self.stderr,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
                env=environment,
            )
        self._without_pid: deque[ForkedProcess] = deque()

    @property
    def runs(self) -> bool:
        return self.process.poll() is None

    def fork(self, pipes: Sequence[int]) -> "ForkedProcess":
        """Ask for a fork; it comes when the server has imported everything."""
        assert len(pipes) == PIPES
        forked = ForkedProcess(self)
        self._without_pid.append(forked)
        # A server that has ended closes the pipes, which the pool notices when it reads.
        with contextlib.suppress(OSError):
            socket.send_fds(self._socket, [REQUEST.pack(FORK)], list(pipes))
        return forked

    def take_pids(self, *, wait: bool) -> None:
        """Read the process ids of forks; without `wait` those that have already come."""
        flags = 0 if wait else socket.MSG_DONTWAIT
        with contextlib.suppress(OSError):
            while self._without_pid and (reply := self._socket.recv(REPLY.size, flags)):
                self._without_pid.popleft().pid, _ = REPLY.unpack(reply)

    def status_of(self, forked: "ForkedProcess") -> int:
        """Wait for the end of a fork and return its status as `Popen.wait` does.

        If the server has ended, all its forks end, and its own status is the reason.
        """
        self.take_pids(wait=True)
        with contextlib.suppress(OSError):
            if forked.pid is not None:
                self._socket.send(REQUEST.pack(forked.pid))
                if reply := self._socket.recv(REPLY.size):
                    return os.waitstatus_to_exitcode(REPLY.unpack(reply)[1])
        return self.process.wait()

    def close(self) -> None:
        """The server ends after its workers; those that go on working are killed."""
        self._socket.close()
        try:
            self.process.wait(END_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.stderr.close()


class ForkedProcess:
    """A worker process that a server forked or will fork."""

    def __init__(self, server: ForkServer) -> None:
        self._server = server
        self.pid: int | None = None
        """None until the server has forked."""
        self._status: int | None = None

    def known_pid(self) -> int:
        """Wait until the server has forked. Raises ProcessLookupError if it ended before."""
        if self.pid is None:
            self._server.take_pids(wait=True)
        if self.pid is None:
            raise ProcessLookupError
        return self.pid

    def kill(self) -> None:
        """Kill the worker. One that does not exist yet can only be prevented with its server."""
        self._server.take_pids(wait=False)
        if self.pid is None:
            self._server.process.kill()
        elif self._status is None and self._server.runs:
            # The number belongs to this worker until the server has waited for it.
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)

    def wait(self) -> int:
        """Wait for the end and return the status as `Popen.wait` does."""
        if self._status is None:
            self._status = self._server.status_of(self)
        return self._status

    def end(self) -> int:
        """End a worker that has closed its output, and return its status."""
        with contextlib.suppress(ProcessLookupError):
            self.known_pid()
        self.kill()
        return self.wait()


def main(argv: Sequence[str] | None = None) -> int:
    """A pool starts this program; people do not."""
    require_assertions("hil")
    parser = argparse.ArgumentParser(prog="hil fork server", description=__doc__)
    parser.add_argument("--parent", type=int, required=True)
    parser.add_argument("--nice", type=int, default=0)
    parser.add_argument("--runner", required=True)
    parser.add_argument("--socket", type=int, required=True)
    options = parser.parse_args(argv)
    die_with_parent(options.parent)
    if options.nice:
        os.nice(options.nice)
    # A case leaves few reference cycles, so the collector runs once in several cases.
    collect_rarely()
    with contextlib.suppress(Exception):
        # Without the module each worker fails to import it, and reports why.
        importlib.import_module(options.runner.partition(":")[0])
    # A collection in a worker would touch all pages of these modules, and so copy them.
    gc.collect()
    gc.freeze()
    with socket.socket(fileno=options.socket) as requests:
        fork_workers(requests)
    # Wait for the last workers, whose input is closed by now.
    with contextlib.suppress(ChildProcessError):
        while True:
            os.wait()
    # Skip the interpreter's cleanup, which takes longer than many cases.
    os._exit(0)


def fork_workers(requests: socket.socket) -> None:
    """Answer requests until the pool closes its side."""
    server = os.getpid()
    while True:
        try:
            body, pipes, _, _ = socket.recv_fds(
                requests, REQUEST.size, PIPES, socket.MSG_CMSG_CLOEXEC
            )
        except OSError:
            # The pool closed its side with replies unread.
            return
        if not body:
            return
        (pid,) = REQUEST.unpack(body)
        status = 0
        if pid == FORK:
            pid = os.fork()
            if pid == 0:
                requests.close()
                _become_worker(server, pipes)
            for each in pipes:
                os.close(each)
        else:
            _, status = os.waitpid(pid, 0)
        try:
            requests.send(REPLY.pack(pid, status))
        except OSError:
            return


def _become_worker(server: int, pipes: Sequence[int]) -> None:
    """Work until the input is closed, and never return."""
    status = 1
    try:
        die_with_parent(server)
        incoming, outgoing, errors = pipes
        # Output that a runner prints must not mix with the messages to the master.
        os.dup2(errors, 1)
        os.dup2(errors, 2)
        os.close(errors)
        # Both stay open until the end, because the pool kills a worker that closes its output.
        files = os.fdopen(incoming, "rb"), os.fdopen(outgoing, "wb")
        serve(*files)
        status = 0
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stderr.flush()
        os._exit(status)


if __name__ == "__main__":
    sys.exit(main())
