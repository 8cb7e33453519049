"""Compiles the hot modules with mypyc into a copy of the packages, which gives the same results
faster.

The sources stay plain Python and run by default. A compiled module beside its source would still be
imported after the source has changed. So the copy has its own folder and commands, and each call
creates it from scratch. It needs a C compiler and Python's headers. Besides the sources, the copy
contains generated constructors of dataclasses, generated packing functions of frames, and the field
types from which settings are read.
"""

import argparse
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.assertions import require_assertions
from firmware_py.native.build import compiler
from metro_hil.model.native_copy import (
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
    with_bound_frames,
    with_kept_types,
    with_native_records,
    with_written_inits,
)

PACKAGES: Final = {
    "can_dbc": "can_dbc",
    "zenoh_config": "zenoh_config",
    "firmware_py": "firmware_py",
    "vobc": "vobc",
    "plant_emulator": "plant_emulator",
    "metro_hil": "hil_tests/metro_hil",
    "metro_tools": "tools/metro_tools",
    "canlog": "tools/canlog",
}
FRAMES: Final = (
    *("can_dbc/alarms.py", "can_dbc/analogue.py", "can_dbc/brake.py", "can_dbc/cab.py"),
    *("can_dbc/doors.py", "can_dbc/energy.py", "can_dbc/odometer.py", "can_dbc/tags.py"),
    *("can_dbc/traction.py", "can_dbc/vobc.py"),
)
"""Modules whose frame classes are compiled together with generated packing functions. The classes
of `diagnostics` are created during import and cannot be compiled."""
WRITTEN: Final = "can_dbc/written_packing.py"
HOT: Final = (
    *FRAMES,
    "can_dbc/codec.py",
    "can_dbc/trailer.py",
    "firmware_py/buses/inproc.py",
    "firmware_py/buses/timing.py",
    "firmware_py/clock/executive.py",
    "firmware_py/storage/port_log.py",
    "firmware_py/radio/inproc_radio.py",
    "firmware_py/radio/recorded_radio.py",
    "firmware_py/storage/recorder.py",
    "firmware_py/tag_reader/inproc_line.py",
    "firmware_py/tag_reader/recorded_line.py",
    "firmware_py/tag_reader/stuffing.py",
    "firmware_py/tag_reader/telegram.py",
    "firmware_py/trackdb/*.py",
    "metro_hil/monitors/gauge.py",
    "metro_hil/monitors/invariants.py",
    "metro_hil/monitors/monitor_set.py",
    "metro_hil/monitors/place.py",
    "metro_hil/monitors/s*.py",
    "metro_hil/monitors/terms.py",
    "metro_hil/monitors/watch_*.py",
    "metro_hil/simulation/*.py",
    "metro_hil/simulation/scenarios/*.py",
    "metro_hil/model/frame_hash.py",
    "metro_hil/line/virtual/member.py",
    "metro_hil/run/lockstep.py",
    "metro_hil/run/case.py",
    "plant_emulator/actuators/*.py",
    "plant_emulator/consist/motion.py",
    "plant_emulator/faults/schedule.py",
    "plant_emulator/noise.py",
    "plant_emulator/power/box.py",
    "plant_emulator/power/flow.py",
    "plant_emulator/power/network.py",
    "plant_emulator/process.py",
    "plant_emulator/sensors/inertial.py",
    "plant_emulator/sensors/tacho.py",
    "plant_emulator/sensors/tag_reader.py",
    "plant_emulator/train_config/*.py",
    "plant_emulator/traffic/coupling.py",
    "plant_emulator/traffic/dispatcher.py",
    "plant_emulator/traffic/member.py",
    "plant_emulator/truth.py",
    "plant_emulator/wayside/*.py",
    "plant_emulator/wire.py",
    "plant_emulator/world.py",
    "vobc/arbitration.py",
    "vobc/config.py",
    "vobc/ato/*.py",
    "vobc/ato/laws/*.py",
    "vobc/ato/model/*.py",
    "vobc/ato/motion/*.py",
    "vobc/ato/settings/*.py",
    "vobc/atp/*.py",
    "vobc/controller.py",
    "vobc/events/*.py",
    "vobc/kinematics.py",
    "vobc/odometry/*.py",
    "vobc/process/*.py",
    "vobc/train_to_train/*.py",
    "vobc/vocabulary/*.py",
    "vobc/wire/*.py",
    "zenoh_config/*.py",
)
"""Modules that take most of the time in a profile."""
LOCKSTEP: Final = (
    "can_dbc/codec.py",
    "firmware_py/clock/executive.py",
    "firmware_py/radio/inproc_radio.py",
    "firmware_py/radio/recorded_radio.py",
    "firmware_py/storage/port_log.py",
    "firmware_py/storage/recorder.py",
    "firmware_py/tag_reader/inproc_line.py",
    "firmware_py/tag_reader/recorded_line.py",
    "firmware_py/tag_reader/stuffing.py",
    "firmware_py/tag_reader/telegram.py",
    "metro_hil/run/lockstep.py",
    "plant_emulator/actuators/*.py",
    "plant_emulator/consist/motion.py",
    "plant_emulator/faults/schedule.py",
    "plant_emulator/noise.py",
    "plant_emulator/power/box.py",
    "plant_emulator/process.py",
    "plant_emulator/sensors/inertial.py",
    "plant_emulator/sensors/tacho.py",
    "plant_emulator/sensors/tag_reader.py",
    "plant_emulator/train_config/train.py",
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
    "vobc/atp/*.py",
    "vobc/controller.py",
    "vobc/events/*.py",
    "vobc/kinematics.py",
    "vobc/odometry/*.py",
    "vobc/process/cycle_log.py",
    "vobc/process/device.py",
    "vobc/vocabulary/*.py",
    "vobc/wire/*.py",
    "zenoh_config/codec.py",
    "zenoh_config/keys.py",
    "zenoh_config/messages.py",
    "zenoh_config/sequencing.py",
)
"""Modules in which a run of one train spends its time where codec, bus and logs are in C."""
SIMULATOR: Final = (
    "firmware_py/trackdb/*.py",
    "metro_hil/simulation/*.py",
    "metro_hil/simulation/scenarios/*.py",
    "plant_emulator/wayside/*.py",
    "vobc/train_to_train/*.py",
    "zenoh_config/*.py",
)
"""Modules in which `hil simulate` spends its time."""
LEFT_OUT: Final = (
    *("/__init__.py", "sessions.py", "secured.py", "t2t_vocabulary.py"),
    "vocabulary/received.py",
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
COMMANDS: Final = {
    "vobc": "metro_hil.cli.entry",
    "plant": "plant_emulator.entry",
    "vcan": "metro_tools.entry",
    "hil": "metro_hil.cli.entry",
}
HEADS: Final = "zenoh_config/t2t.py"
"""The module of the dataclass that all kinds of messages inherit from."""
FLAGS: Final = "-w -fvisibility=hidden -fno-semantic-interposition -ffp-contract=off"
"""Flags for the C compiler. Warnings are off, because checking generated C for them takes several
times as long as compiling. Functions that are not visible outside the library are called directly
or inlined, which saves a fifth of the time. Products are rounded before additions, as in the
interpreter, even on processors with fused multiply-add."""
UNTYPED: Final = "--ignore-missing-imports"
"""Option for mypy: libraries without types are not an error."""
WATCHED: Final = "-fprofile-generate -fprofile-update=single"
TRAINED: Final = "-fprofile-use -fprofile-partial-training"
"""Flags for gcc: the first records a profile when a program ends, the second optimises by it."""
CASES: Final = """\
from metro_hil.campaign.builder import Scenario
from metro_hil.run.dispatch import run_case
for case in Scenario(train={"start": "II", "end": "III"}, seeds=2).cases():
    run_case(case)
"""
RIDE: Final = ("run", "--lockstep", "--json")
SEEDS: Final = (
    ("-m", "metro_hil.cli.hil", "simulate", "--seeds", "20001..20012", "--minutes", "1"),
)
TRAINING: Final = (
    ("-m", "metro_hil.cli.vobc", *RIDE, "--to", "II"),
    ("-c", CASES),
    *SEEDS,
    ("-m", "metro_hil.cli.vobc", *RIDE, "--trains", "7", "--ato", "green", "--duration", "60"),
)
"""Programs that train a copy: a single run, cases with monitors, simulation seeds, whole trains on
a line."""
SETUP: Final = """\
import os
from concurrent.futures import ThreadPoolExecutor

from setuptools import setup
from setuptools._distutils.ccompiler import CCompiler
from mypyc.build import mypycify


def compile_on_all_cores(
    self, sources, output_dir=None, macros=None, include_dirs=None, debug=0,
    extra_preargs=None, extra_postargs=None, depends=None,
):
    macros, objects, after, options, build = self._setup_compile(
        output_dir, macros, include_dirs, sources, depends, extra_postargs
    )
    before = self._get_cc_args(options, debug, extra_preargs)
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for done in [
            pool.submit(self._compile, each, *build[each], before, after, options)
            for each in objects
        ]:
            done.result()
    return objects


CCompiler.compile = compile_on_all_cores
modules = mypycify({modules!r}, opt_level={level!r}, debug_level="0", multi_file=True)
setup(name="compiled", packages=[], ext_modules=modules)
"""
"""Each module is a C file of its own, which takes a sixth of the memory and all cores."""
PACKING: Final = """\
from metro_tools.written_packing import written
print(written({names!r}), end="")
"""
LAUNCHER: Final = """\
#!/bin/sh
export PYTHONSAFEPATH=1 PYTHONPATH="{library}"
exec "{python}" -c "import sys; from {module} import {name}; sys.exit({name}())" "$@"
"""
EXIT_ENVIRONMENT: Final = 3
NICE: Final = 15
"""Priority of the build in the background: it takes what others leave."""
UNUSED_S: Final = 14 * 86_400.0
PART: Final = ".part."
"""Begin of the names of unfinished copies. The lock is held, so no other process makes one."""


class CompileError(Exception):
    """The copy cannot be created; the text gives the reason."""


class Part(NamedTuple):
    """A part of the programs: the modules to compile and the training runs."""

    modules: Sequence[str]
    training: Sequence[Sequence[str]]


def part_of(*, simulator: bool, lockstep: bool = False) -> Part:
    """Return the part for the line simulator or one train alone, or that with all hot modules."""
    if lockstep:
        return Part(LOCKSTEP, TRAINING[:2])
    return Part(SIMULATOR, SEEDS) if simulator else Part(HOT, TRAINING)


def hot_modules(root: Path, patterns: Sequence[str] | None = None) -> list[str]:
    """Return the hot modules of a copy or a checkout as sorted paths that begin with the
    package.
    """
    found: set[str] = set()
    for pattern in HOT if patterns is None else patterns:
        package, _, rest = pattern.partition("/")
        folder = root / package if (root / package).is_dir() else root / PACKAGES[package]
        found |= {f"{package}/{path.relative_to(folder)}" for path in folder.glob(rest)}
    return sorted(name for name in found if not name.endswith(LEFT_OUT))


def copy_packages(source: Path, library: Path) -> None:
    """Copy the packages of a checkout side by side, as they are imported."""
    skip = shutil.ignore_patterns("__pycache__", "*.so")
    for name, place in PACKAGES.items():
        if not (source / place).is_dir():
            raise CompileError(f"{source / place}: not there; this works from a checkout")
        shutil.copytree(source / place, library / name, ignore=skip)


def build_cached(*, wait: bool) -> int:
    """Build the copy of the installed packages in the user's cache, unless another process does."""
    os.nice(NICE)
    folders = package_folders()
    with build_lock(wait=wait) as mine:
        if not mine or ready_copy() is not None:
            return 0
        copies = copies_folder()
        remove_unused(copies)
        with tempfile.TemporaryDirectory(dir=copies, prefix=PART) as place:
            library = Path(place) / "lib"
            skip = shutil.ignore_patterns("__pycache__", "*.so")
            for name, folder in folders.items():
                shutil.copytree(folder, library / name, ignore=skip)
            key = sources_key({name: library / name for name in folders})
            try:
                compile_into(library, "1", lockstep=True)
            except CompileError as error:
                failure_file(key).write_text(f"{error}\n", encoding="utf-8")
                raise
            (copies / key).mkdir(exist_ok=True)
            library.rename(copies / key / "lib")
    return 0


def remove_unused(copies: Path) -> None:
    """Remove copies that no program has entered for a fortnight, and parts of ended builds."""
    now_s = (copies / "lock").stat().st_mtime
    for path in copies.iterdir():
        library = path / "lib"
        unused = library.is_dir() and now_s - library.stat().st_mtime > UNUSED_S
        if unused or path.name.startswith(PART):
            shutil.rmtree(path, ignore_errors=True)


def compile_into(
    library: Path,
    level: str,
    *,
    trained: bool = False,
    simulator: bool = False,
    lockstep: bool = False,
) -> None:
    """Compile each hot module of the copy, with this optimisation level of C.

    With `trained` all modules are compiled twice, the second time by the profile of runs with the
    first.
    """
    part = part_of(simulator=simulator, lockstep=lockstep)
    modules = hot_modules(library, part.modules)
    sources = {name: (library / name).read_bytes() for name in modules}
    bases = set[str]().union(*(bases_in(source.decode()) for source in sources.values()))
    heads = {
        name: each
        for name, each in heads_in((library / HEADS).read_text(encoding="utf-8")).items()
        if name in bases
    }
    written = [] if lockstep else [WRITTEN]
    if written:
        (library / WRITTEN).write_text(_packing(library), encoding="utf-8")
    for name, source in sources.items():
        text = source.decode()
        if name.startswith(RECORDS):
            text = with_native_records(text, TUPLES)
        text = with_written_inits(with_bound_frames(text), bases, heads)
        text = with_kept_types(text)
        (library / name).write_text(text, encoding="utf-8")
    setup = library / "setup.py"
    text = SETUP.format(modules=[UNTYPED, *modules, *written], level=level)
    setup.write_text(text, encoding="utf-8")
    if trained:
        _build(setup, WATCHED)
        _train(library, part.training)
        for path in [*library.rglob("*.so"), *library.rglob("*.o")]:
            path.unlink()
    _build(setup, TRAINED if trained else "")
    setup.unlink()
    (library / WRITTEN).unlink(missing_ok=True)
    for name, source in sources.items():
        (library / name).write_bytes(source)
    shutil.rmtree(library / "build")


def _build(setup: Path, flags: str) -> None:
    given = os.environ.get("CFLAGS", "")
    done = subprocess.run(  # noqa: S603 - our own interpreter and script
        [sys.executable, setup.name, "build_ext", "--inplace"],
        cwd=setup.parent,
        env={
            **os.environ,
            "MYPYPATH": str(setup.parent),
            "CFLAGS": f"{given} {FLAGS} {flags}".strip(),
            **setuptools_compiler(),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        words = [*done.stdout.splitlines(), *done.stderr.splitlines()]
        faults = [line for line in words if "error" in line.lower()] or words
        raise CompileError("\n".join(["mypyc or the C compiler failed:", *faults[-8:]]))


def setuptools_compiler() -> dict[str, str]:
    """Name the compiler to setuptools where only a Python package brings one."""
    found = compiler()
    if found is None or len(found) == 1 or "CC" in os.environ:
        return {}
    command = shlex.join(found)
    return {"CC": command, "LDSHARED": f"{command} -shared"}


def _train(library: Path, training: Sequence[Sequence[str]]) -> None:
    """Run each training program as a process in a temporary folder."""
    with tempfile.TemporaryDirectory() as place:
        for command in training:
            done = subprocess.run(  # noqa: S603 - our own interpreter and modules
                [sys.executable, *command],
                cwd=place,
                env={**os.environ, "PYTHONPATH": str(library), "PYTHONSAFEPATH": "1"},
                capture_output=True,
                text=True,
                check=False,
            )
            if done.returncode != 0:
                last = "\n".join(done.stderr.splitlines()[-8:])
                raise CompileError(f"training with {' '.join(command)} failed:\n{last}")
    if not any((library / "build").rglob("*.gcda")):
        raise CompileError("no profile was written: training needs gcc as C compiler")


def _packing(library: Path) -> str:
    """Return the source of the module of packing functions, from the DBC files of the copy."""
    names = [name.removesuffix(".py").replace("/", ".") for name in FRAMES]
    done = subprocess.run(  # noqa: S603 - our own interpreter and module
        [sys.executable, "-c", PACKING.format(names=names)],
        env={**os.environ, "PYTHONPATH": str(library), "PYTHONSAFEPATH": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise CompileError(f"the packing functions cannot be written:\n{done.stderr}")
    return done.stdout


def write_commands(folder: Path) -> None:
    for name, module in COMMANDS.items():
        command = folder / "bin" / name
        command.parent.mkdir(exist_ok=True)
        words = {"library": folder / "lib", "python": sys.executable}
        text = LAUNCHER.format(**words, module=module, name=name)
        command.write_text(text, encoding="utf-8")
        command.chmod(0o755)


def main(argv: Sequence[str] | None = None) -> int:
    """Create the copy; a missing tool gives one message."""
    require_assertions("compiled")
    parser = argparse.ArgumentParser(prog="python -m metro_tools.compiled", description=__doc__)
    parser.add_argument("--into", default=".compiled", metavar="FOLDER", help="default: .compiled")
    parser.add_argument("--source", default=".", metavar="FOLDER", help="the checkout; default: .")
    parser.add_argument(
        "--optimise",
        default="2",
        choices=("0", "1", "2", "3"),
        help="optimisation level of the C compiler; 0 compiles much faster; default: 2",
    )
    parser.add_argument(
        "--trained",
        action="store_true",
        help="compile twice, the second time by the profile of runs with the first: faster "
        "programs in three times the time; needs gcc",
    )
    parser.add_argument(
        "--simulator",
        action="store_true",
        help="compile only the modules of `hil simulate`, in half the time",
    )
    parser.add_argument(
        "--cached",
        action="store_true",
        help="build what `vobc run --lockstep` uses by itself, into the user's cache",
    )
    parser.add_argument("--wait", action="store_true", help="with --cached: wait for other builds")
    options = parser.parse_args(argv)
    if options.cached:
        try:
            return build_cached(wait=options.wait)
        except (CompileError, OSError) as error:
            print(f"compiled: {error}", file=sys.stderr)
            return EXIT_ENVIRONMENT
    folder, source = Path(options.into).resolve(), Path(options.source).resolve()
    try:
        if folder.exists():
            if not (folder / "lib").is_dir():
                raise CompileError(f"{folder}: exists and is not an earlier copy by this program")
            shutil.rmtree(folder)
        copy_packages(source, folder / "lib")
        compile_into(
            *(folder / "lib", options.optimise),
            trained=options.trained,
            simulator=options.simulator,
        )
    except (CompileError, OSError) as error:
        print(f"compiled: {error}", file=sys.stderr)
        return EXIT_ENVIRONMENT
    write_commands(folder)
    print(folder / "bin" / ("hil simulate" if options.simulator else "vobc run --lockstep"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
