"""Re-simulation: recorded inputs into a controller, its outputs beside the recorded ones.

The recording is `ports.log` of a run folder, written at the controller's own ports: every frame,
telegram byte and radio message with the instant at which it was stamped and the step in which it
was handed over, the instant at which each task began, and how long the run before it took. So a
recording in real time feeds the same inputs into the same cycles as one in virtual time, and both
have to give the same bytes. Only another program in real time is forgiven what `MEASURED` names.
"""

from metro_hil.replay.recording import RecordingError, read_recording
from metro_hil.replay.result import ReplayResult
from metro_hil.replay.run import replay_run

__all__ = ["RecordingError", "ReplayResult", "read_recording", "replay_run"]
