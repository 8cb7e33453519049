"""Sets up a case in real time: buses, gateway, plant and controller."""

import os
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from can_dbc.binding import can_id, kinds, sender
from can_dbc.nodes import Node
from firmware_py import rendezvous
from firmware_py.buses import parse_spec
from firmware_py.clock.clock import Clock
from firmware_py.radio.zenoh_radio import DEFAULT_ENDPOINT, pick_endpoint
from firmware_py.storage.nvram import Nvram
from metro_hil.external_controller.choice import memory_of
from metro_hil.model.case import BenchKind, Case, PlantSpec, plant_text
from metro_hil.model.case_setup import CaseParts, Files
from metro_hil.model.run_folder import RunFolder
from metro_hil.model.subprocesses import Process
from metro_hil.realtime.actors import CaseProcesses, ControllerActor
from metro_hil.realtime.commands import (
    CommandPlaceholders,
    controller_start,
    gateway_words,
    plant_words,
)
from metro_hil.realtime.documents import Documents, write_documents
from metro_hil.realtime.feed_socket import FeedSocket
from metro_hil.realtime.observer import SegmentTap
from metro_hil.realtime.process_faults import refuse_impossible
from metro_hil.realtime.segments import Segments, make_segments, open_taps
from metro_hil.realtime.tolerances import needs_gateway
from metro_hil.realtime.wires import AUTO, Blocked, Parts, RealtimeWires, choose_parts
from plant_emulator.faults.kinds import FaultPlace
from plant_emulator.faults.plan import FaultPlan

LISTEN_S: Final = 1.2
"""Listening time before the start; every node of a train and the controller sends within a
second."""
POLL_NS: Final = 20_000_000
GATEWAY_START_S: Final = 20.0
NODE_OF: Final = {can_id(kind): Node[sender(kind)] for kind in kinds()}
NS_PER_S: Final = 1_000_000_000


@dataclass(slots=True)
class PreparedCase:
    """Everything of a case that exists before it begins."""

    segments: Segments
    parts: Parts
    cast: CaseProcesses
    controller_tap: SegmentTap
    train_tap: SegmentTap
    feed: FeedSocket | None
    """None if the bench does not emulate the train: then the truth is unknown."""
    gateway: Process | None
    gateway_control: Path
    start_plant: Callable[[], Process]
    """Starts the train, each time with a new radio."""
    start_controller: Callable[[], ControllerActor]


def set_stage(
    case: Case,
    made: CaseParts,
    *,
    files: Files,
    folder: RunFolder,
    wires: RealtimeWires,
    clock: Clock,
    stack: ExitStack,
) -> PreparedCase:
    """Prepare a case. Raises Blocked, BusError, RecorderError or OSError if that is impossible."""
    with_gateway = needs_gateway(made.faults)
    segments = make_segments(case.bench, wires, gateway=with_gateway, stack=stack)
    cast = CaseProcesses(folder.path, segments.folders)
    stack.callback(cast.close)
    controller_tap, train_tap = open_taps(segments, folder, clock, stack)
    parts = _parts(case, wires, segments, (controller_tap, train_tap), clock)
    refuse_impossible(made.faults, controller_ours=parts.controller)
    refuse_without_truth(made.faults, plant_ours=parts.plant)
    papers = write_documents(case, made, files, folder.path)
    feed = None
    if parts.plant:
        feed = FeedSocket(segments.meeting / "truth", clock)
        stack.callback(feed.close)
    control = segments.meeting / "control"
    gateway = None
    if with_gateway:
        gateway = _start_gateway(case, wires, segments, papers, control, folder, cast, clock)
    links = _Links(case, made, wires, segments, parts, papers, folder, cast)
    return PreparedCase(
        segments=segments,
        parts=parts,
        cast=cast,
        controller_tap=controller_tap,
        train_tap=train_tap,
        feed=feed,
        gateway=gateway,
        gateway_control=control,
        start_plant=lambda: links.start_plant(feed),
        start_controller=links.start_controller,
    )


def refuse_without_truth(faults: tuple[FaultPlan, ...], *, plant_ours: bool) -> None:
    """Raise Blocked for faults that need an emulated train, or its truth to begin and end."""
    if plant_ours:
        return
    for plan in faults:
        if plan.kind.place is not FaultPlace.BUS:
            raise Blocked(
                f"{plan.kind.name}: acts on the train's {plan.kind.place.value}, and this train is "
                "not emulated here"
            )
        if plan.window.when or plan.window.until:
            raise Blocked(
                f"{plan.kind.name}: its condition needs the truth, which is unknown for this "
                "train; give start_s and duration_s instead"
            )


def _parts(
    case: Case,
    wires: RealtimeWires,
    segments: Segments,
    taps: tuple[SegmentTap, SegmentTap],
    clock: Clock,
) -> Parts:
    heard: set[Node] = set()
    if not segments.own:
        clock.wait_until(clock.now_ns() + round(LISTEN_S * NS_PER_S))
        for tap in {id(tap): tap for tap in taps}.values():
            frames = tap.port.receive(clock.now_ns())
            heard |= {NODE_OF[frame.can_id] for frame in frames if frame.can_id in NODE_OF}
    parts = choose_parts(
        wires, bench=case.bench, virtual=segments.virtual, heard=heard, where=segments.train
    )
    if parts.plant and parts.controller and wires.tags != AUTO:
        raise Blocked(
            f"tags: {wires.tags}: the bench starts both train and controller, so there is no line "
            "between them; leave it out"
        )
    if case.plant != PlantSpec() and not parts.plant:
        raise Blocked(f"{plant_text(case.plant)}: a train is on {segments.train} already")
    if (
        case.bench is BenchKind.HARDWARE
        and not parts.controller
        and case.controller.kind != ("shipped")
    ):
        raise Blocked(
            f"controller.kind: {case.controller.kind!r} cannot be started: one already runs"
        )
    return parts


def _start_gateway(
    case: Case,
    wires: RealtimeWires,
    segments: Segments,
    papers: Documents,
    control: Path,
    folder: RunFolder,
    cast: CaseProcesses,
    clock: Clock,
) -> Process:
    words = gateway_words(
        segments=(segments.controller, segments.train),
        faults=papers.faults,
        seed=case.seed,
        control=control,
        out=folder.path,
        priority=wires.gateway_priority,
        parent=os.getpid(),
    )
    gateway = cast.start("gateway", words)
    until_ns = clock.now_ns() + round(GATEWAY_START_S * NS_PER_S)
    while not control.exists():
        if gateway.ended:
            raise Blocked(f"the gateway ended at its start: {gateway.last_words()}")
        if clock.now_ns() > until_ns:
            raise Blocked(f"the gateway was not ready within {GATEWAY_START_S:.0f} s")
        clock.wait_until(clock.now_ns() + POLL_NS)
    return gateway


class _Links:
    """Starts train and controller with the wires that connect them."""

    def __init__(
        self,
        case: Case,
        made: CaseParts,
        wires: RealtimeWires,
        segments: Segments,
        parts: Parts,
        papers: Documents,
        folder: RunFolder,
        cast: CaseProcesses,
    ) -> None:
        self._case, self._made, self._wires = case, made, wires
        self._segments, self._parts, self._papers = segments, parts, papers
        self._folder, self._cast = folder, cast
        self._radio = self._choose_radio()

    def _choose_radio(self) -> str:
        if self._wires.radio != AUTO:
            return self._wires.radio
        if self._parts.plant:
            return pick_endpoint()
        return rendezvous.read_radio(parse_spec(self._segments.train).name) or DEFAULT_ENDPOINT

    def start_plant(self, feed: FeedSocket | None) -> Process:
        assert feed is not None
        self._radio = self._choose_radio()
        journey = self._made.journey
        words = plant_words(
            self._case,
            bus=self._segments.train,
            wires=self._wires,
            radio=self._radio,
            line=self._papers.line,
            consist=self._papers.consist,
            faults=self._papers.faults,
            feed=feed.path,
            out=self._folder.path,
            stations=(journey.start.name, journey.end.name),
            parent=os.getpid(),
            recording=self._papers.recording,
        )
        return self._cast.start("plant", words)

    def start_controller(self) -> ControllerActor:
        setup, journey, wires = self._case.setup, self._made.journey, self._wires
        tags = wires.tags
        if tags == AUTO:
            tags = str(rendezvous.tags_link(parse_spec(self._segments.train).name))
        nvram = self._folder.path / "nvram"
        if journey.wakes_up:
            Nvram(nvram).put(memory_of(journey, self._made.config))
        start = controller_start(
            self._case.controller,
            CommandPlaceholders(
                bus=self._segments.controller,
                tags=tags,
                radio=self._radio,
                line=self._papers.line,
                params=self._papers.params,
                start=journey.start.name,
                end=journey.end.name,
                out=str(self._folder.path),
                stops=",".join(setup.stops or ()),
            ),
            cycle_ms=setup.cycle_ms,
            priority=wires.controller_priority,
            nvram=nvram,
            environment=os.environ,
            wakes_up=journey.wakes_up,
        )
        return ControllerActor(self._cast, start)
