"""Which kernel a guest boots, and how the choice is reported."""

import itertools

import pytest

from metro_tools.guest.kernels import (
    AUTOMATIC,
    GuestKernel,
    Processor,
    booting_line,
    choose,
    failure_text,
)
from metro_tools.guest.plan import NoKernelError, emulated_memory_mib
from metro_tools.guest.processor import this_processor

AVX512_FRAME_BYTES = 3632
AMX_FRAME_BYTES = 11952


@pytest.mark.parametrize("frame_bytes", [None, 1776, 3376, AVX512_FRAME_BYTES])
def test_the_stock_kernel_comes_first_where_it_works(frame_bytes: int | None) -> None:
    choice = choose(AUTOMATIC, Processor({"avx512f", "xsave"}, frame_bytes))

    assert choice.kernels == (GuestKernel.STOCK, GuestKernel.NEWER, GuestKernel.QEMU)


@pytest.mark.parametrize(
    ("flags", "frame_bytes"),
    [
        ({"amx_tile"}, AMX_FRAME_BYTES),
        ({"amx_tile"}, None),
        (set[str](), AMX_FRAME_BYTES),
        (set[str](), AVX512_FRAME_BYTES + 1),
    ],
)
def test_the_newer_kernel_is_tried_first_where_the_stock_kernel_crashes(
    flags: set[str], frame_bytes: int | None
) -> None:
    choice = choose(AUTOMATIC, Processor(flags, frame_bytes))

    assert choice.kernels == (GuestKernel.NEWER, GuestKernel.STOCK, GuestKernel.QEMU)


@pytest.mark.parametrize("kernel", GuestKernel)
def test_a_kernel_that_is_asked_for_is_the_only_one(kernel: GuestKernel) -> None:
    for flags in ({"amx_tile"}, set[str]()):
        assert choose(kernel.value, Processor(flags, None)).kernels == (kernel,)


def test_the_emulated_pc_is_always_the_last_resort() -> None:
    for flags, frame_bytes in itertools.product(({"amx_tile"}, set[str]()), (None, 1, 99999)):
        kernels = choose(AUTOMATIC, Processor(flags, frame_bytes)).kernels

        assert kernels[-1] is GuestKernel.QEMU
        assert set(kernels) == set(GuestKernel)


def test_this_machines_processor_flags_are_read() -> None:
    """Every processor of this architecture has SSE2."""
    processor = this_processor()

    assert "sse2" in processor.flags
    assert processor.signal_frame_bytes is None or processor.signal_frame_bytes > 1000


def test_one_line_names_the_kernel_its_release_and_the_reason() -> None:
    line = booting_line(GuestKernel.NEWER, "7.2.7", "the processor has AMX")

    assert "\n" not in line
    for part in ("newer", "7.2.7", "the processor has AMX"):
        assert part in line


def test_a_reason_that_all_kernels_share_is_reported_once() -> None:
    text = failure_text([(kernel, "apt-get is missing") for kernel in GuestKernel])

    assert text == "apt-get is missing"


def test_different_reasons_are_reported_with_their_kernels() -> None:
    text = failure_text([(GuestKernel.STOCK, "it died"), (GuestKernel.QEMU, "no memory")])

    assert text.splitlines()[1:] == ["stock: it died", "qemu: no memory"]


def test_an_emulated_pc_gets_the_requested_or_the_available_memory() -> None:
    assert emulated_memory_mib(available_mib=9000, wanted_mib=2048) == 2048
    assert emulated_memory_mib(available_mib=1000, wanted_mib=2048) == 936
    assert emulated_memory_mib(available_mib=448, wanted_mib=2048) == 384
    with pytest.raises(NoKernelError, match="only 447 MiB"):
        emulated_memory_mib(available_mib=447, wanted_mib=2048)
