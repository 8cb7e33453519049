"""`canlog plot LOG signal… -o out.png`: signals over time or distance in one command."""

import argparse

from canlog.verbs.asked import (
    log_options,
    name_asked,
    output_path,
    read_asked,
    span_asked,
)


def options(parser: argparse.ArgumentParser) -> None:
    log_options(parser)
    parser.add_argument(
        "signals",
        nargs="*",
        metavar="SIGNAL",
        help="MESSAGE.signal, a signal by itself, or a pattern; each makes a panel, names joined"
        " by commas share one; default: the most informative signals",
    )
    parser.add_argument(
        "-o", "--out", default="canlog.png", help=".png or .svg; default: %(default)s"
    )
    parser.add_argument("--x", choices=("time", "distance"), default="time")
    parser.add_argument("--distance", metavar="SIGNAL", help="the signal with the distance")
    parser.add_argument("--no-events", action="store_true", help="mark no events")


def run(given: argparse.Namespace) -> int:
    """Draw the picture. Raises LogError."""
    path = output_path(given.out, (".png", ".svg"))
    log = read_asked(given)
    span = span_asked(log, given)
    from canlog.views.happenings import happenings
    from canlog.views.place import place_of
    from canlog.views.plot import Picture, draw
    from canlog.views.span import date_text
    from canlog.views.traces import default_words, panels_of

    panels = panels_of(log, given.signals or default_words(log))
    place = place_of(log, given.distance) if given.x == "distance" else None
    since = date_text(span.zero_ns)
    title = f"{name_asked(given)}{f', from {since}' if since else ''}"
    picture = Picture(title, panels, span, () if given.no_events else happenings(log), place)
    drawn = draw(picture, path)
    held = sum(len(trace) for panel in panels for trace in panel)
    print(f"{path}: {len(panels)} panels, {held} samples drawn as {drawn}")
    return 0
