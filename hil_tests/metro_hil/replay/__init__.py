"""Replay: feeds recorded inputs to a controller and compares its outputs with the recorded ones.

The recording is `ports.log` of a run folder, written at the controller's own ports. It holds every
frame, telegram byte and radio message with its time stamp, and the step that received it. It also
holds when each task began, and how long its previous run took.

A recording in real time therefore feeds the same inputs into the same cycles as one in virtual
time, and both must give the same bytes. Only another program in real time may differ in the signals
that `MEASURED` names.
"""

from metro_hil.replay.recording import RecordingError, read_recording
from metro_hil.replay.result import ReplayResult
from metro_hil.replay.run import replay_run

__all__ = ["RecordingError", "ReplayResult", "read_recording", "replay_run"]
