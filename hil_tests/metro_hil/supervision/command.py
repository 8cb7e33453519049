"""Supervision of a line over zenoh: `vobc line`, `master`, `hold`, `restrict` and others."""

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

from canlog.live.options import add_serving
from canlog.views.serving import LOOPBACK
from firmware_py.clock.clock import WallClock
from firmware_py.command_line import CommandParser
from firmware_py.radio.credentials import load_credentials
from firmware_py.radio.line_keys import line_keys
from firmware_py.radio.zenoh_radio import RadioError, SessionRole, ZenohRadio, open_radio
from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineMap, load_line
from firmware_py.trackdb.areas import AreaMap, load_areas
from firmware_py.trackdb.circuit import with_route
from firmware_py.trackdb.version import database_version
from metro_hil.model.line_options import add_insecure
from metro_hil.model.run_options import (
    EXIT_ENVIRONMENT,
    EXIT_OK,
    EXIT_USAGE,
    LINE_VERBS,
    SERVICE_VERBS,
    train_number,
)
from metro_hil.model.service import line_of_service
from metro_hil.supervision.access import refuse_insecure
from metro_hil.supervision.console import SupervisionConsole
from metro_hil.supervision.network import (
    NetworkDesk,
    PathDesk,
    SupervisedPath,
    chosen_path,
    paths_of,
    text_of,
)
from metro_hil.supervision.view import KMH, LineView
from plant_emulator.wayside.separation import Stretch
from zenoh_config import t2t_keys
from zenoh_config.secured import SUPERVISION_NAME
from zenoh_config.sessions import LINE_ENDPOINT
from zenoh_config.soundness import MAX_CHAINAGE_M, MAX_SPEED_MPS
from zenoh_config.t2t_supervision import DecreeKind

LINE: Final = "loop"
WATCH_S: Final = 0.5
OF_ROUTE: Final = ("switch-master", "remove-train", "restrict", "close")
"""Verbs that need a route of a network. A stretch is then commanded on all paths over its track."""
LOOK_S: Final = 1.5
"""Time to receive the state of the line before anything is displayed."""
SESSION_S: Final = 5.0
"""Time to wait for a session: two attempts by TLS on a busy machine, and some margin."""
OF_TRAIN: Final = {
    "hold": (DecreeKind.HOLD, DecreeKind.LET_GO),
    "skip": (DecreeKind.SKIP, DecreeKind.CALL),
    "emergency-brake": (DecreeKind.EMERGENCY, DecreeKind.RELEASE),
}
"""The command of each verb and the one that takes it back."""
OF_TRACK: Final = {
    "restrict": (DecreeKind.RESTRICT, DecreeKind.LIFT),
    "close": (DecreeKind.CLOSE, DecreeKind.OPEN),
}


WebPage = Callable[[argparse.Namespace, LineView, ZenohRadio, WallClock], int]
"""Serves the page of a line until the user interrupts, and returns the exit code."""


def main(words: Sequence[str], page: WebPage | None = None) -> int:
    """Run one verb of supervision and return its exit code.

    Args:
        page: what `line --web` calls; None where there is no page.

    Exit code 2: unknown train, line or endpoint. Exit code 3: the command was not carried out, or
    no train commands what is to be displayed. Exit code 130: ended by Ctrl-C, except `line
    --watch` and `line --web`.
    """
    options = parser().parse_args(words)
    try:
        if options.service_file is not None:
            return _supervise_network(options, page)
        options.line = options.line or LINE
        return _supervise(options, load_areas(options.line), load_line(options.line), page)
    except (SettingsError, RadioError) as error:
        print(f"vobc: {error}", file=sys.stderr)
        return EXIT_USAGE
    except KeyboardInterrupt:
        if not (getattr(options, "watch", False) or getattr(options, "web", False)):
            raise
        return EXIT_OK


def _supervise(
    options: argparse.Namespace, areas: AreaMap, line: LineMap, page: WebPage | None
) -> int:
    _check(options, areas)
    clock, secure = WallClock(), None
    if options.secure is not None:
        secure = load_credentials(options.secure, SUPERVISION_NAME, clock.epoch_ns())
    key = line_keys(secure)
    view = LineView(areas, key)
    topics = t2t_keys.of_supervision(areas.name)
    with open_radio(
        *(SessionRole.TRAIN, options.line_radio, topics, clock),
        secure=secure,
        watched_tokens=t2t_keys.tokens(areas.name),
    ) as port:
        if options.service_file is None:
            # A train on a network declares no token on the line of a path.
            view.tokens = lambda: port.present
        desk = SupervisionConsole(clock, view, port, key, database_version(line))
        if not desk.listen(SESSION_S, lambda: port.connected):
            return _no_session(options)
        if page is not None and getattr(options, "web", False):
            return page(options, view, port, clock)
        displays = options.verb in ("line", "master")
        desk.listen(LOOK_S, lambda: not displays and view.complete)
        return _obey(options, desk, view, clock)


def _no_session(options: argparse.Namespace) -> int:
    also = "" if options.secure is None else ", with the same certificate authority"
    print(
        f"vobc: {options.line_radio}: no session; does a wayside run there{also}?", file=sys.stderr
    )
    return EXIT_ENVIRONMENT


def _supervise_network(options: argparse.Namespace, page: WebPage | None) -> int:
    """Supervise all paths of a service, or that of the route that the user named."""
    if options.line is not None:
        raise SettingsError("--line: not with --service, whose file names its network")
    paths, path, web = paths_of(options.service_file), None, getattr(options, "web", False)
    if options.verb in OF_ROUTE or web or options.route is not None:
        path = chosen_path(paths, options.route, options.service_file)
    _check(options, (path or paths[0]).areas)
    if path is not None and web:
        options.route = path.route
        options.line = with_route(line_of_service(options.service_file), path.route)
        return _supervise(options, path.areas, path.path.line, page)
    clock, secure = WallClock(), None
    if options.secure is not None:
        secure = load_credentials(options.secure, SUPERVISION_NAME, clock.epoch_ns())
    topics = [topic for each in paths for topic in t2t_keys.of_supervision(each.name)]
    with open_radio(*(SessionRole.TRAIN, options.line_radio, topics, clock), secure=secure) as port:
        network = NetworkDesk(paths, port, clock, line_keys(secure))
        if not network.listen(SESSION_S, lambda: port.connected):
            return _no_session(options)
        network.listen(LOOK_S)
        return _obey_network(options, network, path, clock)


def _obey_network(
    options: argparse.Namespace,
    network: NetworkDesk,
    path: SupervisedPath | None,
    clock: WallClock,
) -> int:
    """Carry out the verb on the paths that it is about.

    Args:
        path: of the route that the user named.
    """
    if options.verb in ("line", "master"):
        return show_network(options, network.only(path), clock)
    if path is not None and options.verb in OF_TRACK:
        stretch = Stretch(path.path, options.start_m, options.end_m)
        return network.on_stretch(stretch, partial(_obey_stretch, options))
    if path is not None:
        (desk,) = network.only(path)
        return _obey(options, desk.console, desk.view, clock)
    found = network.of_train(options.number)
    if found is None:
        print(
            f"vobc: train {options.number}: no report of it is received on any path of "
            f"{options.service_file}",
            file=sys.stderr,
        )
        return EXIT_ENVIRONMENT
    return _obey(options, found.console, found.view, clock)


def show_network(options: argparse.Namespace, desks: Sequence[PathDesk], clock: WallClock) -> int:
    """Print the trains or masters of paths, with `--watch` until the user ends it."""

    def lines(view: LineView) -> list[str]:
        return (view.words if options.verb == "line" else view.reasons)(clock.now_ns())

    console = desks[0].console
    while getattr(options, "watch", False):
        console.say(text_of(desks, lines), over=True)
        for desk in desks:
            desk.console.listen(WATCH_S / len(desks))
    console.say(text_of(desks, lines))
    if any(desk.view.commands for desk in desks):
        return EXIT_OK
    heard = next((each for each in desks if not each.view.receives_nothing), desks[0])
    return heard.console.fail_without_command("any path" if len(desks) > 1 else "")


def _obey_stretch(
    options: argparse.Namespace, desk: SupervisionConsole, start_m: float, end_m: float
) -> int:
    wanted, back = OF_TRACK[options.verb]
    limit_mps = (getattr(options, "limit_kmh", None) or 0.0) / KMH
    return desk.decree(
        back if options.end else wanted, start_m=start_m, end_m=end_m, limit_mps=limit_mps
    )


def _check(options: argparse.Namespace, areas: AreaMap) -> None:
    """Raise SettingsError for options that are invalid on any line."""
    refuse_insecure(options)
    verb = options.verb
    if options.route is not None and options.service_file is None:
        raise SettingsError(f"{verb}: --route: only with --service")
    if verb == "line":
        _check_page(options)
    if verb == "switch-master" and options.area not in {a.number for a in areas.areas}:
        raise SettingsError(f"--area {options.area}: {areas.name} has no such area")
    if verb == "restrict" and not options.end and options.limit_kmh is None:
        raise SettingsError("restrict: --limit KMH is missing; --end takes a restriction back")
    if verb in OF_TRACK and not options.start_m < options.end_m:
        stretch = f"START {options.start_m:g} END {options.end_m:g}"
        raise SettingsError(f"{verb}: {stretch}: the stretch must end beyond its start")


def _check_page(options: argparse.Namespace) -> None:
    """Raise SettingsError for options of the page that do not fit together."""
    listens = options.listen != LOOPBACK
    given = {
        "--commands": options.commands,
        "--port": options.port != 0,
        "--listen": listens,
        "--no-browser": options.no_browser,
    }
    for name, is_given in given.items():
        if is_given and not options.web:
            raise SettingsError(f"line: {name} is for the page in the browser; add --web")
    if options.commands and listens:
        raise SettingsError(
            f"line: --commands with --listen {options.listen}: the page is not encrypted, so it "
            f"takes commands on this machine only; leave out one of the two"
        )


def _obey(
    options: argparse.Namespace, desk: SupervisionConsole, view: LineView, clock: WallClock
) -> int:
    verb = options.verb
    if verb == "line":
        while options.watch:
            desk.say(view.words(clock.now_ns()), over=True)
            desk.listen(WATCH_S)
        desk.say(view.words(clock.now_ns()))
        return EXIT_OK if view.commands else desk.fail_without_command()
    if verb == "master":
        desk.say(view.reasons(clock.now_ns()))
        return EXIT_OK if view.commands else desk.fail_without_command()
    if verb == "switch-master":
        return desk.switch(options.area, options.to)
    if verb == "out-of-service":
        return desk.retire(options.number, end=options.end)
    if verb == "remove-train":
        return desk.remove(options.number)
    if verb in OF_TRAIN:
        wanted, back = OF_TRAIN[verb]
        return desk.decree(back if options.end else wanted, train=options.number)
    return _obey_stretch(options, desk, options.start_m, options.end_m)


def parser() -> argparse.ArgumentParser:
    top = CommandParser(prog="vobc", description=__doc__)
    verbs = top.add_subparsers(dest="verb", required=True, metavar="VERB")
    parsers = {
        verb: verbs.add_parser(verb, help=words, description=f"{words.capitalize()}.")
        for verb, words in LINE_VERBS.items()
    }
    line, switch, remove = (parsers[verb] for verb in ("line", "switch-master", "remove-train"))
    shown = line.add_mutually_exclusive_group()
    shown.add_argument(
        "--watch",
        action="store_true",
        help="update the display until Ctrl-C, which gives exit code 0",
    )
    shown.add_argument(
        "--web",
        action="store_true",
        help="show the line in a browser until Ctrl-C, which gives exit code 0",
    )
    line.add_argument(
        "--commands",
        action="store_true",
        help="with --web: let the page send commands of supervision, each after a confirmation",
    )
    add_serving(line)
    switch.add_argument("--area", type=int, required=True)
    switch.add_argument("--to", type=train_number, required=True, metavar="TRAIN")
    service = line.add_subparsers(dest="service", metavar="VERB")
    for verb, words in SERVICE_VERBS.items():
        service.add_parser(verb, help=words, add_help=False)
    remove.description = (
        "Report that a non-communicating train is gone, so that no other train waits behind it. A "
        "person must have seen that it left the line. The master refuses while it receives the "
        "train, or counts axles where it may be that no train standing there accounts for."
    )
    remove.add_argument("number", type=train_number, metavar="TRAIN")
    for verb in ("out-of-service", *OF_TRAIN):
        parsers[verb].add_argument("number", type=train_number, metavar="TRAIN")
        parsers[verb].add_argument("--end", action="store_true", help="take the command back")
    for verb in OF_TRACK:
        parsed = parsers[verb]
        parsed.add_argument(
            "start_m", type=_chainage_m, metavar="START", help="start of the stretch, m"
        )
        parsed.add_argument("end_m", type=_chainage_m, metavar="END")
        if verb == "restrict":
            parsed.add_argument("--limit", dest="limit_kmh", type=_speed_kmh, metavar="KMH")
        parsed.add_argument(
            "--end", action="store_true", help="take the command for this stretch back"
        )
    for parsed in parsers.values():
        parsed.add_argument("--line", metavar="NAME|FILE", help=f"default: {LINE}")
        parsed.add_argument(
            "--service",
            dest="service_file",
            metavar="FILE",
            help="instead of a line: the network of this service, with all paths of its trips",
        )
        parsed.add_argument(
            "--route",
            metavar="ROUTE",
            help="with --service: the route whose path, areas or chainages are meant",
        )
        parsed.add_argument("--line-radio", default=LINE_ENDPOINT, metavar="ENDPOINT")
        parsed.add_argument("--secure", metavar="FOLDER", help="certificates; see `vobc demo-ca`")
        add_insecure(parsed)
    return top


def _chainage_m(text: str) -> float:
    return _number(text, -MAX_CHAINAGE_M, MAX_CHAINAGE_M)


def _speed_kmh(text: str) -> float:
    return _number(text, 1.0, MAX_SPEED_MPS * KMH)


def _number(text: str, least: float, most: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not least <= value <= most:
        raise argparse.ArgumentTypeError(f"{text} is not a number in {least:g}..{most:g}")
    return value
