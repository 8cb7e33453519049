"""The plan of `vcan` works on the described machine; where no plan works, there is none."""

from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from metro_tools.vcan_plan import (
    CanSupport,
    Commands,
    Kernel,
    KernelLink,
    NameTaken,
    NotAvailable,
    Nothing,
    name_fault,
    plan_down,
    plan_up,
)

ALL = Kernel(
    support=CanSupport.READY,
    evidence="seen",
    has_ip=True,
    has_modprobe=True,
    may_configure=True,
    may_load=True,
)

kernels = st.builds(
    Kernel,
    support=st.sampled_from(CanSupport),
    evidence=st.just("seen"),
    has_ip=st.booleans(),
    has_modprobe=st.booleans(),
    may_configure=st.booleans(),
    may_load=st.booleans(),
)
links = st.none() | st.builds(
    KernelLink,
    name=st.just("vcan0"),
    kind=st.sampled_from(["vcan", "can", "vxcan", "ether"]),
    is_up=st.booleans(),
    is_ours=st.booleans(),
)


@dataclass
class PaperMachine:
    """Reacts to these commands like a real machine, including its refusals."""

    kernel: Kernel
    links: dict[str, KernelLink] = field(default_factory=dict)

    def run(self, words: tuple[str, ...]) -> None:
        match words:
            case ("modprobe", "vcan"):
                assert self.kernel.has_modprobe
                assert self.kernel.may_load
                assert self.kernel.support is not CanSupport.ABSENT
                self.kernel = replace(self.kernel, support=CanSupport.READY)
            case ("ip", "link", "add", "dev", name, "type", "vcan"):
                self._check_rights()
                assert self.kernel.support is CanSupport.READY
                assert name not in self.links
                self.links[name] = KernelLink(name, "vcan", is_up=False, is_ours=False)
            case ("ip", "link", "set", "dev", name, "alias", "made by vcan up"):
                self._check_rights()
                self.links[name] = replace(self.links[name], is_ours=True)
            case ("ip", "link", "set", "dev", name, "up"):
                self._check_rights()
                self.links[name] = replace(self.links[name], is_up=True)
            case ("ip", "link", "delete", "dev", name):
                self._check_rights()
                del self.links[name]
            case _:
                raise AssertionError(words)

    def _check_rights(self) -> None:
        assert self.kernel.has_ip
        assert self.kernel.may_configure


@given(kernels, links)
def test_the_plan_for_up_works_and_is_idempotent(kernel: Kernel, link: KernelLink | None) -> None:
    step = plan_up("vcan0", kernel, link)

    machine = PaperMachine(kernel, {} if link is None else {"vcan0": link})
    if isinstance(step, Commands):
        for words in step.words:
            machine.run(words)
        made = machine.links["vcan0"]
        assert (made.kind, made.is_up) == ("vcan", True)
        assert isinstance(plan_up("vcan0", machine.kernel, made), Nothing)


@given(kernels, links)
def test_up_has_no_plan_only_where_something_is_missing(
    kernel: Kernel, link: KernelLink | None
) -> None:
    """With everything available there is always a plan, unless another kind of interface has the
    name."""
    step = plan_up("vcan0", kernel, link)

    if link is not None and link.kind != "vcan":
        assert isinstance(step, NameTaken)
    elif link is not None and link.is_up:
        assert isinstance(step, Nothing)
    else:
        loads = link is None and kernel.support is not CanSupport.READY
        can = kernel.has_ip and kernel.may_configure
        if link is None:
            can = can and kernel.support is not CanSupport.ABSENT
        if loads:
            can = can and kernel.has_modprobe and kernel.may_load
        assert isinstance(step, Commands if can else NotAvailable)


@given(kernels)
def test_down_reverts_up(kernel: Kernel) -> None:
    machine = PaperMachine(kernel)
    step = plan_up("vcan0", kernel, None)
    if not isinstance(step, Commands):
        return
    for words in step.words:
        machine.run(words)

    back = plan_down("vcan0", machine.kernel, machine.links["vcan0"])

    assert isinstance(back, Commands)
    for words in back.words:
        machine.run(words)
    assert machine.links == {}
    assert isinstance(plan_down("vcan0", machine.kernel, None), Nothing)


@given(kernels, st.sampled_from(["vcan", "can", "vxcan", "ether"]), st.booleans())
def test_down_removes_only_what_up_created(kernel: Kernel, kind: str, is_up: bool) -> None:
    step = plan_down("vcan0", kernel, KernelLink("vcan0", kind, is_up=is_up, is_ours=False))

    assert isinstance(step, NameTaken)


@pytest.mark.parametrize(
    ("lacking", "words"),
    [
        ({"support": CanSupport.ABSENT}, "no vcan: seen"),
        ({"has_ip": False}, "`ip` is missing"),
        ({"may_configure": False}, "CAP_NET_ADMIN"),
        ({"support": CanSupport.LOADABLE, "has_modprobe": False}, "`modprobe` is missing"),
        ({"support": CanSupport.LOADABLE, "may_load": False}, "CAP_SYS_MODULE"),
    ],
)
def test_exactly_the_missing_parts_are_named(lacking: dict[str, Any], words: str) -> None:
    step = plan_up("vcan0", replace(ALL, **lacking), None)

    assert isinstance(step, NotAvailable)
    assert words in step.reason


def test_without_rights_the_complete_commands_are_shown() -> None:
    kernel = replace(ALL, support=CanSupport.LOADABLE, may_configure=False)

    step = plan_up("vcan0", kernel, None)

    assert isinstance(step, NotAvailable)
    assert step.remedy == (
        "sudo modprobe vcan",
        "sudo ip link add dev vcan0 type vcan",
        "sudo ip link set dev vcan0 alias 'made by vcan up'",
        "sudo ip link set dev vcan0 up",
    )


def test_a_physical_interface_is_not_changed_and_its_use_is_explained() -> None:
    step = plan_up("can0", ALL, KernelLink("can0", "can", is_up=False, is_ours=False))

    assert isinstance(step, NameTaken)
    assert "--bus socketcan:can0" in step.text


@pytest.mark.parametrize("name", ["vcan0", "v", "a" * 15, "CAN_1.x-y", "0"])
def test_a_name_valid_for_the_kernel_is_accepted(name: str) -> None:
    assert name_fault(name) is None


@pytest.mark.parametrize(
    "name", ["", "a" * 16, "ä" * 8, "vcan 0", "a/b", ".", "..", "-x", "a:b", "a\n", "ü", ".vcan"]
)
def test_an_invalid_name_is_refused_by_name(name: str) -> None:
    fault = name_fault(name)

    assert fault is not None
    assert not name or repr(name) in fault
