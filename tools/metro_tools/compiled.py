"""Compiles modules with mypyc into a copy of the packages in the user's cache, which gives the same
results faster.

The sources stay plain Python. Programs find the copy by the hash of its sources, and start this
build themselves (`metro_hil.model.native_copy`). It needs a C compiler and Python's headers.
Besides the sources, the copy contains generated constructors of dataclasses, and the field types
from which settings are read.
"""

import argparse
import compileall
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.assertions import require_assertions
from firmware_py.native.build import CompileTarget, compiler, here
from metro_hil.model.native_copy import (
    LIBRARY,
    Part,
    build_lock,
    copies_folder,
    failure_file,
    package_folders,
    ready_copy,
    sources_key,
)
from metro_tools.written_inits import (
    bases_in,
    heads_in,
    with_kept_types,
    with_native_records,
    with_written_inits,
)

TRAIN: Final = (
    "can_dbc/codec.py",
    "firmware_py/clock/executive.py",
    "firmware_py/radio/inproc_radio.py",
    "firmware_py/radio/recorded_radio.py",
    "firmware_py/storage/lines.py",
    "firmware_py/storage/port_log.py",
    "firmware_py/storage/recorder.py",
    "firmware_py/tag_reader/inproc_line.py",
    "firmware_py/tag_reader/recorded_line.py",
    "firmware_py/tag_reader/stuffing.py",
    "firmware_py/tag_reader/telegram.py",
    "firmware_py/trackdb/line_map.py",
    "firmware_py/trackdb/sites.py",
    "metro_hil/line/virtual/member.py",
    "metro_hil/model/frame_hash.py",
    "metro_hil/monitors/gauge.py",
    "metro_hil/monitors/invariants.py",
    "metro_hil/monitors/monitor_set.py",
    "metro_hil/monitors/place.py",
    "metro_hil/monitors/s*.py",
    "metro_hil/monitors/terms.py",
    "metro_hil/monitors/watch_*.py",
    "metro_hil/run/case.py",
    "metro_hil/run/lockstep.py",
    "plant_emulator/actuators/*.py",
    "plant_emulator/consist/*.py",
    "plant_emulator/faults/schedule.py",
    "plant_emulator/noise.py",
    "plant_emulator/power/box.py",
    "plant_emulator/power/flow.py",
    "plant_emulator/power/network.py",
    "plant_emulator/process.py",
    "plant_emulator/sensors/inertial.py",
    "plant_emulator/sensors/tacho.py",
    "plant_emulator/sensors/tag_reader.py",
    "plant_emulator/traffic/coupling.py",
    "plant_emulator/traffic/dispatcher.py",
    "plant_emulator/traffic/member.py",
    "plant_emulator/train_config/*.py",
    "plant_emulator/truth.py",
    "plant_emulator/wayside/centre.py",
    "plant_emulator/wayside/platform_doors.py",
    "plant_emulator/wayside/railway.py",
    "plant_emulator/wayside/zone_controller.py",
    "plant_emulator/wire.py",
    "plant_emulator/world.py",
    "vobc/arbitration.py",
    "vobc/ato/*.py",
    "vobc/ato/laws/*.py",
    "vobc/ato/model/*.py",
    "vobc/ato/motion/*.py",
    "vobc/ato/settings/*.py",
    "vobc/atp/*.py",
    "vobc/config.py",
    "vobc/controller.py",
    "vobc/events/*.py",
    "vobc/kinematics.py",
    "vobc/odometry/*.py",
    "vobc/process/cycle_log.py",
    "vobc/process/device.py",
    "vobc/vocabulary/*.py",
    "vobc/wire/*.py",
    "vobc/zones.py",
    "zenoh_config/codec.py",
    "zenoh_config/keys.py",
    "zenoh_config/messages.py",
    "zenoh_config/sequencing.py",
    "zenoh_config/soundness.py",
)
"""Modules in which runs of trains and campaigns spend their time. Codec, bus and logs are in C."""
SIMULATOR: Final = (
    "firmware_py/trackdb/*.py",
    "metro_hil/simulation/*.py",
    "metro_hil/simulation/scenarios/*.py",
    "plant_emulator/wayside/*.py",
    "vobc/train_to_train/*.py",
    "zenoh_config/*.py",
)
"""Modules in which `hil simulate` spends its time."""
MODULES: Final[Mapping[Part, Sequence[str]]] = {Part.TRAIN: TRAIN, Part.SIMULATOR: SIMULATOR}
QUICK: Final = (
    "can_dbc/codec.py",
    "firmware_py/clock/executive.py",
    "firmware_py/storage/*.py",
    "metro_hil/run/lockstep.py",
    "metro_hil/simulation/*.py",
    "plant_emulator/actuators/*.py",
    "plant_emulator/consist/motion.py",
    "plant_emulator/process.py",
    "plant_emulator/sensors/tacho.py",
    "plant_emulator/truth.py",
    "plant_emulator/wire.py",
    "plant_emulator/world.py",
    "vobc/ato/model/*.py",
    "vobc/ato/motion/*.py",
    "vobc/ato/laws/predictive.py",
    "vobc/ato/operation.py",
    "vobc/atp/energy_check.py",
    "vobc/atp/protection.py",
    "vobc/atp/station.py",
    "vobc/controller.py",
    "vobc/odometry/*.py",
    "vobc/process/device.py",
    "vobc/train_to_train/*.py",
    "vobc/wire/*.py",
    "zenoh_config/codec.py",
)
"""Modules that the C compiler optimises. Optimising the others takes longer than it saves."""
LEFT_OUT: Final = (
    *("/__init__.py", "sessions.py", "secured.py", "t2t_vocabulary.py"),
    *(f"zenoh_config/{name}.py" for name in ("bodies", "t2t_types")),
    *(
        f"simulation/{name}.py"
        for name in ("state_search", "batch", "model_check", "guard_removal")
    ),
    "simulation/simulate.py",
)
"""Path endings of modules that are not compiled. They start processes, are seldom run, or define
base classes whose constructors cannot be generated. The generic dataclass in `t2t_vocabulary` does
not import when mypyc has compiled it."""
RECORDS: Final = (
    "metro_hil/simulation/",
    "plant_emulator/power/",
    "plant_emulator/wayside/",
    "vobc/ato/",
    "vobc/atp/",
    "vobc/train_to_train/",
)
"""Folders in which named tuples become native classes. Elsewhere they are packed as tuples, or
their field names are read."""
TUPLES: Final = (
    *(
        "AreaMemory",
        "DelayTap",
        "DepartureTerms",
        "DoorEnable",
        "DoorTerms",
        "Due",
        "Grain",
        "MessageHead",
    ),
    *("_Answers", "_Four", "_Phase", "_Piece", "_Step"),
)
"""Named tuples that stay tuples, because code unpacks, sorts or counts them; mypyc rejects any
other such use."""
HEADS: Final = "zenoh_config/t2t.py"
"""The module of the dataclass that all kinds of messages inherit from."""
FLAGS: Final = (
    *("-w", "-g0", "-fPIC", "-fwrapv", "-DNDEBUG", "-fno-sanitize=undefined"),
    *("-fvisibility=hidden", "-fno-semantic-interposition", "-ffp-contract=off"),
)
"""Flags for the C compiler. Warnings are off, because checking generated C for them takes several
times as long as compiling. Products are rounded before additions, as in the interpreter, even on
processors with fused multiply-add. A compiler from zig would check for undefined behaviour."""
LEVELS: Final = {True: "-O1", False: "-O0"}
"""Optimisation of `QUICK` and of the other modules."""
UNIT_BYTES: Final = 3_000_000
"""C code that is compiled at once: many modules share the time for Python's headers. One unit
takes 0.3 GB of memory."""
UNTYPED: Final = "--ignore-missing-imports"
"""Option for mypy: libraries without types are not an error."""
GENERATE: Final = """\
import json, sys
from mypyc.build import mypycify
sys.stdout = sys.stderr
made = mypycify({modules!r}, opt_level="1", debug_level="0", multi_file=True)
found = [[each.name, each.sources, each.include_dirs] for each in made]
print(json.dumps(found), file=sys.__stdout__)
"""
START: Final = """\
#include <Python.h>
static PyObject *start(const char *library, const char *attribute, const char *name) {
    PyObject *names = Py_BuildValue("(s)", "*");
    if (names == NULL) return NULL;
    PyObject *found = PyImport_ImportModuleLevel(library, NULL, NULL, names, 0);
    Py_DECREF(names);
    if (found == NULL) return NULL;
    PyObject *capsule = PyObject_GetAttrString(found, attribute);
    Py_DECREF(found);
    if (capsule == NULL) return NULL;
    PyObject *(*run)(void) = (PyObject *(*)(void))PyCapsule_GetPointer(capsule, name);
    Py_DECREF(capsule);
    return run == NULL ? NULL : run();
}
"""
START_ONE: Final = """\
PyMODINIT_FUNC PyInit_{last}(void) {{
    return start("{library}", "init_{name}", "{library}.init_{name}");
}}
"""
"""Python calls this function of the shared library when it imports a module by its last name."""
EXIT_ENVIRONMENT: Final = 3
NICE: Final = 15
"""Priority of the build in the background: it takes what others leave."""
UNUSED_S: Final = 86_400.0
KEPT: Final = 3
"""Copies that stay although no program has entered them for a day. One takes 60 MB of disk."""
PART: Final = ".part."
"""Begin of the names of unfinished copies. The lock is held, so no other process makes one."""


class CompileError(Exception):
    """The copy cannot be created; the text gives the reason."""


class Generated(NamedTuple):
    """C code of one library, and the names of the modules in it."""

    library: str
    sources: Sequence[Path]
    includes: Sequence[str]
    modules: Sequence[str]


def hot_modules(folders: Mapping[str, Path], patterns: Iterable[str]) -> list[str]:
    """Return the modules that match as sorted paths that begin with the package.

    Args:
        folders: folder of each package, by its name.
        patterns: package and glob.
    """
    found: set[str] = set()
    for pattern in patterns:
        package, _, rest = pattern.partition("/")
        folder = folders[package]
        found |= {f"{package}/{path.relative_to(folder)}" for path in folder.glob(rest)}
    return sorted(name for name in found if not name.endswith(LEFT_OUT))


def build(part: Part, *, wait: bool) -> int:
    """Build the copy of the installed packages in the user's cache, unless another process does."""
    os.nice(NICE)
    folders = package_folders()
    with build_lock(wait=wait) as mine:
        if not mine or ready_copy(part) is not None:
            return 0
        copies = copies_folder()
        remove_unused(copies)
        with tempfile.TemporaryDirectory(dir=copies, prefix=PART) as place:
            library = Path(place) / LIBRARY
            key = sources_key(copy_sources(folders, library), part)
            command = compiler()
            assert command is not None, "programs ask for the tools before they start a build"
            try:
                compile_into(library, part, here(command))
            except CompileError as error:
                failure_file(key).write_text(f"{error}\n", encoding="utf-8")
                raise
            # Else each program would compile the other modules again where it may not write.
            compileall.compile_dir(library, quiet=2, stripdir=place, prependdir=copies / key)
            (copies / key).mkdir(exist_ok=True)
            library.rename(copies / key / LIBRARY)
    return 0


def copy_sources(folders: Mapping[str, Path], library: Path) -> dict[str, Path]:
    """Copy packages into a folder, and return the folder of each."""
    skip = shutil.ignore_patterns("__pycache__", "*.so")
    for name, folder in folders.items():
        shutil.copytree(folder, library / name, ignore=skip)
    return {name: library / name for name in folders}


def remove_unused(copies: Path) -> None:
    """Remove copies that no program has entered for a day, but for the newest, and parts of ended
    builds.
    """
    now_s = (copies / "lock").stat().st_mtime
    for path in copies.glob(f"{PART}*"):
        shutil.rmtree(path, ignore_errors=True)
    entered_s = {path.parent: path.stat().st_mtime for path in copies.glob(f"*/{LIBRARY}")}
    for path in sorted(entered_s, key=lambda each: -entered_s[each])[KEPT:]:
        if now_s - entered_s[path] > UNUSED_S:
            shutil.rmtree(path, ignore_errors=True)


def compile_into(library: Path, part: Part, target: CompileTarget) -> None:
    """Compile the hot modules of the copy. Raises CompileError."""
    folders = {path.name: path for path in library.iterdir()}
    modules = hot_modules(folders, MODULES[part])
    sources = {name: (library / name).read_bytes() for name in modules}
    bases = set[str]().union(*(bases_in(source.decode()) for source in sources.values()))
    heads = {
        name: each
        for name, each in heads_in((library / HEADS).read_text(encoding="utf-8")).items()
        if name in bases
    }
    for name, source in sources.items():
        text = source.decode()
        if name.startswith(RECORDS):
            text = with_native_records(text, TUPLES)
        text = with_kept_types(with_written_inits(text, bases, heads))
        (library / name).write_text(text, encoding="utf-8")
    made = _generated(library, [UNTYPED, *modules])
    for name, source in sources.items():
        (library / name).write_bytes(source)
    quick = {name.removesuffix(".py") for name in hot_modules(folders, QUICK)}
    _compile(library, made, quick, target)
    shutil.rmtree(library / "build")


def _generated(library: Path, words: Sequence[str]) -> Generated:
    """Write C code for these modules with mypyc."""
    done = subprocess.run(  # noqa: S603 - our own interpreter
        [sys.executable, "-c", GENERATE.format(modules=[*words])],
        cwd=library,
        env={**os.environ, "MYPYPATH": str(library)},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise CompileError(_reason("mypyc", done.stdout + done.stderr))
    found = json.loads(done.stdout.splitlines()[-1])
    name, sources, includes = max(found, key=lambda each: len(each[1]))
    modules = sorted(each[0] for each in found if each[0] != name)
    return Generated(name, [library / path for path in sources], includes, modules)


def _reason(program: str, words: str) -> str:
    lines = words.splitlines()
    faults = [line for line in lines if "error" in line.lower()] or lines
    return "\n".join([f"{program} failed:", *faults[-8:]])


def _compile(library: Path, made: Generated, quick: set[str], target: CompileTarget) -> None:
    """Compile the C code on all cores, and link one library for all modules."""
    folder = library / "build"
    commands: list[list[str]] = []
    for level, sources in units(made.sources, quick):
        unit = folder / f"unit{len(commands)}.c"
        unit.write_text("".join(f'#include "{path}"\n' for path in sources), encoding="utf-8")
        commands.append([LEVELS[level], "-c", str(unit), "-o", f"{unit}.o"])
    starts = []
    for number, modules in enumerate(without_equal_last_names(made.modules)):
        file = folder / f"start{number}.c"
        text = [START_ONE.format(**start_words(made.library, name)) for name in modules]
        file.write_text(START + "".join(text), encoding="utf-8")
        shared = library / f"{made.library}_{number}{target.suffix}"
        commands.append(["-O1", "-shared", str(file), "-o", str(shared)])
        starts.append((shared, modules))
    includes = [target.headers, *made.includes, str(folder)]
    flags = [*FLAGS, *(f"-I{path}" for path in includes)]
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for _ in pool.map(
            lambda words: _run_compiler(library, [*target.command, *flags, *words]), commands
        ):
            pass
    objects = [words[-1] for words in commands if "-shared" not in words]
    _run_compiler(
        library,
        [*target.command, "-shared", *objects, "-o", f"{made.library}{target.suffix}", "-lm"],
    )
    for shared, modules in starts:
        for name in modules:
            place = library / (name.replace(".", "/") + target.suffix)
            place.symlink_to(os.path.relpath(shared, place.parent))


def units(
    sources: Sequence[Path], quick: set[str], unit_bytes: int = UNIT_BYTES
) -> list[tuple[bool, list[Path]]]:
    """Distribute C files over units of similar size, each optimised or not."""
    found: list[tuple[bool, list[Path]]] = []
    for level in (True, False):
        chosen = [path for path in sources if (_module_of(path) in quick) is level]
        total = sum(path.stat().st_size for path in chosen)
        if not chosen:
            continue
        parts: list[list[Path]] = [[] for _ in range(-(-total // unit_bytes))]
        sizes = [0] * len(parts)
        for path in sorted(chosen, key=lambda each: (-each.stat().st_size, each.name)):
            least = sizes.index(min(sizes))
            parts[least].append(path)
            sizes[least] += path.stat().st_size
        found += [(level, part) for part in parts if part]
    return found


def _module_of(path: Path) -> str:
    """Return package and path of the module whose C file mypyc gave this name."""
    return path.stem.removeprefix("__native_").replace("___", "/")


def without_equal_last_names(modules: Sequence[str]) -> list[list[str]]:
    """Distribute modules over lists in which no last name occurs twice."""
    found: list[dict[str, str]] = []
    for name in modules:
        last = name.rpartition(".")[2]
        free = next((each for each in found if last not in each), None)
        if free is None:
            free = {}
            found.append(free)
        free[last] = name
    return [[*each.values()] for each in found]


def start_words(library: str, name: str) -> dict[str, str]:
    return {
        "library": library,
        "last": name.rpartition(".")[2],
        "name": name.replace(".", "___"),
    }


def _run_compiler(library: Path, command: Sequence[str]) -> None:
    done = subprocess.run(  # noqa: S603 - a compiler and generated sources
        command, cwd=library, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise CompileError(_reason(command[0], done.stderr))


def main(argv: Sequence[str] | None = None) -> int:
    """Create the copy; a missing tool gives one message."""
    require_assertions("compiled")
    parser = argparse.ArgumentParser(prog="python -m metro_tools.compiled", description=__doc__)
    parser.add_argument(
        "--part",
        choices=[each.value for each in Part],
        default=Part.TRAIN.value,
        help="train: controller, train, runs and monitors; simulator: `hil simulate`",
    )
    parser.add_argument("--wait", action="store_true", help="wait while another build runs")
    options = parser.parse_args(argv)
    part = Part(options.part)
    try:
        status = build(part, wait=options.wait)
    except (CompileError, OSError) as error:
        print(f"compiled: {error}", file=sys.stderr)
        return EXIT_ENVIRONMENT
    if options.wait:
        print(ready_copy(part))
    return status


if __name__ == "__main__":
    sys.exit(main())
