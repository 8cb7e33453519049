"""Lets runs in virtual time use C for codec, bus and logs where the machine can build it."""

import enum
import functools
from typing import Any

from can_dbc import c_source, codec
from firmware_py.buses.inproc import BusStatistics
from firmware_py.buses.timing import frame_bits
from firmware_py.native.build import BuildError, extension
from firmware_py.native.core import STEM, core_sources, use_core
from firmware_py.ports import CanFrame, LinkCounters
from firmware_py.storage.lines import field_text
from metro_hil.model.native_copy import SWITCH, Native, native_choice


@functools.cache
def use_native() -> str:
    """Let new buses, logs, encoders and decoders use C; return why not, else an empty text."""
    if native_choice() is Native.OFF:
        return f"{SWITCH}={Native.OFF.value}"
    try:
        wire, core = codec_module(), core_module()
    except BuildError as error:
        return str(error)
    codec.use_compiled(wire)
    use_core(core)
    return ""


def codec_module() -> Any:
    """Return the codec in C. Raises BuildError."""
    return extension("codec", c_source.sources())


def core_module() -> Any:
    """Return bus and logs in C, ready to use. Raises BuildError."""
    module: Any = extension(STEM, core_sources())
    module.use(
        frame=CanFrame,
        counters=LinkCounters,
        statistics=BusStatistics,
        frame_bits=frame_bits,
        field_text=field_text,
        enum_type=type(enum.Enum),
    )
    return module
