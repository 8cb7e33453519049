"""All results of one run, for people and as JSON."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from metro_hil.metrics.comfort import Comfort
from metro_hil.metrics.hops import HopEnergy, means_of
from metro_hil.metrics.run import Cycles, RideComfort, SupervisionEvent
from metro_hil.metrics.stops import StationStop

BLOCK_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class RunResults:
    """Results of one run; a value that could not be measured is None."""

    exit_reason: str
    stops: Sequence[StationStop]
    ride: RideComfort | None
    cycles: Cycles | None
    events: Sequence[SupervisionEvent]
    """Changes of protection, and reports of a late or weak brake, in order of time."""
    frames: int
    bus_load_ratio: float
    frame_log_sha256: str
    real_time_factor: float | None = None
    """Virtual seconds per second; None in real time."""
    hops: Sequence[HopEnergy] = ()
    rejected_frames: Mapping[str, int] = field(default_factory=dict)
    comfort: Comfort = field(default_factory=Comfort)
    truth_known: bool = True
    """Whether motion and stops are the plant's true values; otherwise they are the controller's."""
    dropped_frames: int = 0
    """Number of frames on the bus that are missing in the log."""
    lost_log_lines: int = 0
    """Number of log lines that the disk refused."""
    steal_s: float | None = None
    realtime: Sequence[str] = ()
    """Lines about scheduling, memory lock and the like, as the host granted them."""
    nodes: Sequence[str] = ()
    """What happened at each LS-BUS node."""

    def to_json(self) -> str:
        """One JSON object; the keys for scripts come first, the others after them."""
        return json.dumps(
            _finite(
                {
                    "exit_reason": self.exit_reason,
                    "real_time_factor": self.real_time_factor,
                    "stops": [asdict(stop) for stop in self.stops],
                    "hops": means_of(self.hops),
                    "max_accel_mps2": self.ride.max_accel_mps2 if self.ride else None,
                    "max_jerk_mps3": self.ride.max_jerk_mps3 if self.ride else None,
                    **self.comfort.measures(),
                    "frames": self.frames,
                    "frame_log_sha256": self.frame_log_sha256,
                    "slips": self.cycles.slips if self.cycles else None,
                    "bus_load_ratio": self.bus_load_ratio,
                    "rejected_frames": dict(self.rejected_frames),
                    "truth_known": self.truth_known,
                    "dropped_frames": self.dropped_frames,
                    "lost_log_lines": self.lost_log_lines,
                    "ride": asdict(self.ride) if self.ride else None,
                    "cycles": asdict(self.cycles) if self.cycles else None,
                    "supervision_events": [asdict(event) for event in self.events],
                    "steal_s": self.steal_s,
                    "realtime": list(self.realtime),
                    **({"nodes": list(self.nodes)} if self.nodes else {}),
                }
            ),
            indent=2,
            allow_nan=False,
        )


def _finite(value: object) -> object:
    """Replace numbers that JSON does not know, such as NaN, by null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's content, or of nothing if there is no such file."""
    digest = hashlib.sha256()
    if path.exists():
        with path.open("rb") as content:
            while block := content.read(BLOCK_BYTES):
                digest.update(block)
    return digest.hexdigest()
