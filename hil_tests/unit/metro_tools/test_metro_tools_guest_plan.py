"""The settings that a guest receives before it boots."""

import shlex
import subprocess
from pathlib import Path, PurePath

import pytest
from hypothesis import given
from hypothesis import strategies as st

import metro_tools.guest
from metro_tools.guest.packages import merge_usr
from metro_tools.guest.plan import (
    Engine,
    GuestError,
    GuestFolders,
    GuestRequest,
    MemoryPlace,
    choose_memory,
    command_script,
    interface_name_fault,
    kernel_arguments,
    library_names,
    settings_script,
)

MACHINE = GuestFolders(
    engine=Engine.UML,
    kernel=PurePath("/cache/kernel/linux"),
    busybox=PurePath("/cache/kernel/busybox"),
    modules=PurePath("/a b/modules"),
    toolbox=PurePath("/a b/toolbox"),
    run_dir=PurePath("/run/it"),
)


def request(*command: str, environment: dict[str, str] | None = None) -> GuestRequest:
    return GuestRequest(
        command=command,
        directory="/",
        environment=environment or {},
        umask=0o027,
        interfaces=("vcan0", "vcan1"),
        writable=("/",),
        timeout_s=9,
        hostname="it's",
        one_stream=False,
    )


def place(path: str, free_mib: int, kind: str = "tmpfs", executable: bool = True) -> MemoryPlace:
    return MemoryPlace(path, kind, executable, free_mib)


def test_the_first_folder_with_enough_room_is_used() -> None:
    chosen, memory_mib = choose_memory([place("/a", 1000), place("/b", 4000)], 2048)

    assert (chosen.path, memory_mib) == ("/b", 2048)


def test_with_less_room_the_guest_gets_less() -> None:
    chosen, memory_mib = choose_memory([place("/a", 600), place("/b", 1000)], 2048)

    assert (chosen.path, memory_mib) == ("/b", 936)


@given(
    st.lists(
        st.builds(
            MemoryPlace,
            path=st.just("/x"),
            kind=st.sampled_from(["tmpfs", "ext4"]),
            executable=st.booleans(),
            free_mib=st.integers(0, 8192),
        )
    ),
    st.integers(384, 8192),
)
def test_memory_never_exceeds_its_place(places: list[MemoryPlace], wanted_mib: int) -> None:
    try:
        chosen, memory_mib = choose_memory(places, wanted_mib)
    except GuestError:
        usable = [p for p in places if p.kind == "tmpfs" and p.executable and p.free_mib >= 448]
        assert usable == []
        return

    assert chosen in places
    assert (chosen.kind, chosen.executable) == ("tmpfs", True)
    assert 384 <= memory_mib <= min(wanted_mib, chosen.free_mib - 64)


def test_every_unsuitable_folder_is_named_with_its_reason() -> None:
    places = [place("/a", 99), place("/b", 9999, executable=False), place("/c", 9999, "ext4")]

    with pytest.raises(GuestError) as refusal:
        choose_memory(places, 2048)

    for words in ("/a has only 99 MiB", "/b is mounted noexec", "/c is not a tmpfs"):
        assert words in str(refusal.value)


@pytest.mark.parametrize("name", ["vcan0", "a" * 15])
def test_interface_names_that_the_kernel_accepts(name: str) -> None:
    assert interface_name_fault(name) is None


@pytest.mark.parametrize("name", ["", "a" * 16, "a b", "a/b", "a:b", ".", "..", "-a", "a\n", "%d"])
def test_interface_names_that_the_kernel_refuses(name: str) -> None:
    assert interface_name_fault(name) is not None


def test_the_kernel_gets_its_lines_in_order() -> None:
    words = kernel_arguments(MACHINE, 512, control=(5, 6), streams=[7, 8])

    assert words[0] == "/cache/kernel/linux"
    for word in ("mem=512M", "ssl0=fd:5,fd:6", "ssl1=null,fd:7", "ssl2=null,fd:8"):
        assert word in words
    assert not any(" " in word for word in words)


def test_settings_survive_a_shell() -> None:
    script = (
        settings_script(request("true"), MACHINE) + 'printf "%s|" "$hostname" "$toolbox" $streams'
    )

    done = subprocess.run(["sh", "-c", script], capture_output=True, text=True, check=True)

    assert done.stdout == "it's|/a b/toolbox|1|2|"


text = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20)


@given(st.lists(text, min_size=1, max_size=4), st.dictionaries(st.just("ODD"), text))
def test_arguments_and_environment_reach_the_command_unchanged(
    words: list[str], environment: dict[str, str]
) -> None:
    script = command_script(
        request("cmd", *words, environment=environment), Engine.QEMU, "bb", "timeout"
    )

    last = script[script.index("exec ") :]
    variables = [f"ODD={value}" for value in environment.values()]
    assert shlex.split(last) == [
        *("exec", "bb", "env", "-i", *variables, "VCAN_GUEST=qemu"),
        *("timeout", "-k", "10", "9", "cmd", *words),
    ]


def test_the_umask_and_directory_are_set_before_the_command() -> None:
    lines = command_script(request("true"), Engine.UML, "bb", "timeout").splitlines()

    assert lines[:2] == ["umask 0027", "cd / || exit 125"]


def test_only_needed_libraries_are_copied_and_never_the_c_library() -> None:
    said = """iproute2
  Depends: debconf
 |Depends: libelf1
  Depends: libc6
  Depends: zlib1g
  PreDepends: libmnl0:amd64
  Recommends: libatm1
  Suggests: libsuggested
  Conflicts: libold
  Depends: <libvirtual>
    libreal
"""

    assert library_names(said) == {"libelf1", "zlib1g", "libmnl0"}


def test_a_tree_under_a_merged_root_has_no_conflicting_folders(tmp_path: Path) -> None:
    for path in ("bin/ip", "usr/bin/cansend", "lib/x/libz.so.1"):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(path)
    (tmp_path / "sbin").mkdir()
    (tmp_path / "sbin/ip").symlink_to("/bin/ip")

    merge_usr(tmp_path)

    assert [entry.name for entry in tmp_path.iterdir()] == ["usr"]
    assert (tmp_path / "usr/bin/ip").read_text() == "bin/ip"
    assert (tmp_path / "usr/lib/x/libz.so.1").read_text() == "lib/x/libz.so.1"
    assert (tmp_path / "usr/sbin/ip").readlink() == Path("/bin/ip")


def test_the_first_process_is_a_script_that_a_shell_can_read() -> None:
    script = Path(metro_tools.guest.__file__).with_name("init.sh")

    done = subprocess.run(["sh", "-n", str(script)], capture_output=True, check=False)

    assert (done.returncode, done.stderr) == (0, b"")
