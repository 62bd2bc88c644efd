"""The choice of LLVM library and of Mitsuba's variant. Nothing else in the package chooses a variant.

Dr.Jit loads libLLVM at run time. A library older than LLVM 16 ends the whole process with an abort at the
first render, which Python cannot catch, so its version is read here before any kernel is compiled.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Final

from sfsnet_dr.core.errors import InputError, RunError, nearest

#: The variable that Dr.Jit itself reads.
LLVM_VARIABLE: Final = "DRJIT_LIBLLVM_PATH"

#: Oldest LLVM major version that compiles every kernel of Dr.Jit 1.5.
OLDEST_LLVM: Final = 16

#: The package that brings a known LLVM, and the command that installs it.
LLVM_PACKAGE: Final = "karellen-llvm-core"
LLVM_COMMAND: Final = f"pip install {LLVM_PACKAGE}"

DEFAULT_VARIANT: Final = "llvm_ad_rgb"

#: Where operating systems, package managers and Conda put libLLVM.
_SYSTEM_PATTERNS: Final = (
    ("/", "usr/lib/*-linux-gnu/libLLVM*.so*"),
    ("/", "usr/lib64/libLLVM*.so*"),
    ("/", "usr/lib/libLLVM*.so*"),
    ("/", "usr/lib/llvm*/lib/libLLVM*.so*"),
    ("/", "usr/lib64/llvm*/lib/libLLVM*.so*"),
    ("/", "usr/local/lib/libLLVM*.so*"),
    ("/", "opt/homebrew/opt/llvm*/lib/libLLVM*.dylib"),
    ("/", "usr/local/opt/llvm*/lib/libLLVM*.dylib"),
    ("C:/", "Program Files/LLVM/bin/LLVM-C.dll"),
    (sys.prefix, "lib/libLLVM*"),
    (sys.prefix, "Library/bin/LLVM-C.dll"),
)

_NAME_VERSION = re.compile(r"libLLVM-(\d+)\b|libLLVM[^/]*?\.so\.(\d+(?:\.\d+)*)$")

#: Run in a process of its own: prints the version of the library named by its argument.
_ASK_VERSION: Final = """
import ctypes, sys
library = ctypes.CDLL(sys.argv[1])
numbers = [ctypes.c_uint() for _ in range(3)]
library.LLVMGetVersion(*map(ctypes.byref, numbers))
print(".".join(str(n.value) for n in numbers))
"""


@dataclass(frozen=True)
class LlvmChoice:
    """A libLLVM that Dr.Jit may load.

    Attributes:
        path: the library file.
        version: as far as it could be read without loading it here: ``"23.1"``, ``"15"``.
        source: what chose it: the environment variable's name, the package's name, or ``"system"``.
    """

    path: Path
    version: str
    source: str

    @property
    def major(self) -> int:
        """Major version, for comparisons."""
        return int(self.version.split(".")[0])


_chosen: LlvmChoice | None = None
_started_in: int | None = None


def find_llvm() -> LlvmChoice:
    """Choose libLLVM: ``DRJIT_LIBLLVM_PATH``'s, else karellen-llvm-core's, else the system's newest.

    Raises:
        InputError: if the one named is missing, unreadable or older than LLVM 16, or if none is found.
    """
    if _chosen is not None:
        return _chosen
    named = os.environ.get(LLVM_VARIABLE)
    if named:
        return _check(_named_choice(named))
    packaged = _packaged_library()
    if packaged is not None:
        return _check(LlvmChoice(packaged, llvm_version(packaged), LLVM_PACKAGE))
    return _check(_system_choice())


def start(variant: str = DEFAULT_VARIANT) -> None:
    """Make ``import mitsuba`` usable: choose libLLVM, then set the variant. Calling it again costs nothing.

    Args:
        variant: one of Mitsuba's compiled variants.

    Raises:
        InputError: if no good libLLVM is found, or the variant does not exist.
        RunError: if Dr.Jit cannot start its backend.
    """
    global _chosen, _started_in
    needs_llvm = variant.startswith("llvm")
    if needs_llvm and _chosen is None:
        choice = find_llvm()
        os.environ[LLVM_VARIABLE] = str(choice.path)
        _chosen = choice
    import mitsuba as mi

    if mi.variant() == variant:
        return
    if variant not in mi.variants():
        raise InputError(f"variant {variant!r}: not compiled into Mitsuba; {nearest(variant, mi.variants())}")
    try:
        mi.set_variant(variant)
    except ImportError as error:
        raise RunError(f"variant {variant!r} did not start: {_last_line(str(error))}") from error
    if needs_llvm:
        _check_loaded_version()
        _started_in = os.getpid()


def check_process() -> None:
    """Refuse to compute in a child that was forked after ``start``.

    Dr.Jit's threads stay behind in the parent. A child would work on small arrays and wait for ever on
    others.

    Raises:
        InputError: in such a child.
    """
    if _started_in not in (None, os.getpid()):
        raise InputError(
            "process forked after Dr.Jit had started, whose threads did not come along; start workers by "
            "'spawn' (multiprocessing.get_context('spawn')), or use the torch form there"
        )


def loaded_llvm_version() -> str:
    """Version of the LLVM that Dr.Jit has loaded; call :func:`start` first."""
    import drjit as dr

    return ".".join(str(n) for n in dr.detail.llvm_version())


def threads() -> int:
    """Number of threads in Dr.Jit's pool."""
    import drjit as dr

    return int(dr.thread_count())


def set_threads(count: int) -> None:
    """Limit Dr.Jit's pool, for processes that share the machine."""
    start()
    import drjit as dr

    dr.set_thread_count(count)


def llvm_version(path: Path) -> str:
    """Read a library's LLVM version without loading it into this process.

    The resolved file name is believed where it holds a version; otherwise a process of its own asks the
    library. ``start`` checks once more with what Dr.Jit reports after loading.

    Raises:
        InputError: if the library cannot be loaded or does not answer (``LLVMGetVersion`` came with LLVM 16).
    """
    match = _NAME_VERSION.search(path.resolve().name)
    if match:
        return match[1] or match[2]
    asked = subprocess.run(
        [sys.executable, "-c", _ASK_VERSION, str(path)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    if asked.returncode != 0:
        found = f"asking for its LLVM version failed ({_last_line(asked.stderr)})"
        raise InputError(f"{path}: {found}; LLVM {OLDEST_LLVM} or later is needed: {LLVM_COMMAND}")
    return asked.stdout.strip()


def _check(choice: LlvmChoice) -> LlvmChoice:
    if choice.major >= OLDEST_LLVM:
        return choice
    raise InputError(_refusal(choice, choice.version))


def _refusal(choice: LlvmChoice, version: str) -> str:
    remedy = LLVM_COMMAND
    if choice.source == LLVM_VARIABLE:
        remedy += f" and unset {LLVM_VARIABLE}"
    return (
        f"{choice.path}: LLVM {version} found (chosen by {choice.source}), "
        f"{OLDEST_LLVM} or later is needed because older ones abort the process: {remedy}"
    )


def _named_choice(named: str) -> LlvmChoice:
    path = Path(named)
    if not path.is_file():
        raise InputError(
            f"{LLVM_VARIABLE}={named}: no such file; unset it, or name a libLLVM {OLDEST_LLVM} or later"
        )
    return LlvmChoice(path, llvm_version(path), LLVM_VARIABLE)


def _packaged_library() -> Path | None:
    try:
        files = metadata.distribution(LLVM_PACKAGE).files or []
    except metadata.PackageNotFoundError:
        return None
    names = re.compile(r"libLLVM\.so\.[\d.]+|libLLVM\.dylib|LLVM-C\.dll")
    libraries = (Path(str(file.locate())).resolve() for file in files if names.fullmatch(file.name))
    return next((library for library in libraries if library.is_file()), None)


def _system_choice() -> LlvmChoice:
    found = list(_system_libraries())
    if not found:
        raise InputError(f"libLLVM: none found, LLVM {OLDEST_LLVM} or later is needed: {LLVM_COMMAND}")
    return max(found, key=lambda choice: choice.major)


def _system_libraries() -> Iterator[LlvmChoice]:
    paths = {path.resolve() for root, pattern in _SYSTEM_PATTERNS for path in Path(root).glob(pattern)}
    for path in sorted(paths):
        try:
            yield LlvmChoice(path, llvm_version(path), "system")
        except InputError:
            continue  # a library that does not answer is older than LLVM 16, or not LLVM


def _check_loaded_version() -> None:
    version = loaded_llvm_version()
    if int(version.split(".")[0]) < OLDEST_LLVM:
        loaded = _chosen or LlvmChoice(Path("libLLVM"), version, "Dr.Jit")
        raise InputError(_refusal(loaded, version))


def _last_line(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1] if lines else "no message"
