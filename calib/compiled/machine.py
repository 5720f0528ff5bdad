"""The compiler for the processor of this machine, and the cache folder in which compiled rows are kept."""

from __future__ import annotations

import ctypes
import hashlib
import os
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

from calib.compiled import sparse
from calib.compiled.fused import POINTERS, Shape, fused
from calib.compiled.intermediate import LIBRARY, Instruction, intermediate

FORMAT = b"calib rows 1\n"  # first line of a cached file; the digest of what follows stands behind it


def cache_folder() -> Path | None:
    """Folder of compiled code: that of CALIB_CACHE, else in the cache folder of the user; None where there is none."""
    if chosen := os.environ.get("CALIB_CACHE"):
        return Path(chosen) / "rows"
    try:
        if sys.platform == "win32":
            base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
        elif sys.platform == "darwin":
            base = Path.home() / "Library" / "Caches"
        else:
            base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:  # no home folder
        return None
    return base / "calib" / "rows"


def _kept(path: Path) -> bytes | None:
    """Compiled code of a cached file, None where it is not there, not whole, or writable by others."""
    try:
        with path.open("rb") as file:
            if hasattr(os, "getuid"):
                status = os.fstat(file.fileno())
                if status.st_uid != os.getuid() or status.st_mode & 0o022:
                    return None
            content = file.read()
    except OSError:
        return None
    head = len(FORMAT) + 32
    whole = content.startswith(FORMAT) and hashlib.sha256(content[head:]).digest() == content[len(FORMAT) : head]
    return content[head:] if whole else None


def _keep(path: Path, code: bytes) -> None:
    """Write a cached file whole or not at all; a folder that cannot be written is no reason to stop."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        handle, name = tempfile.mkstemp(dir=path.parent, suffix=".part")
    except OSError:
        return
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(FORMAT + hashlib.sha256(code).digest() + code)
        Path(name).replace(path)
    except OSError:
        Path(name).unlink(missing_ok=True)


class Compiler:
    """The compiler for the processor of this machine."""

    def __init__(self) -> None:
        import llvmlite
        from llvmlite import binding

        self._binding = binding
        with suppress(RuntimeError):
            binding.initialize()  # older versions need it, newer ones raise
        binding.initialize_native_target()
        binding.initialize_native_asmprinter()
        features = binding.get_host_cpu_features()
        name, flags = binding.get_host_cpu_name(), features.flatten()
        self.lanes = 8 if features.get("avx512f") else 4 if features.get("avx") else 2
        target = binding.Target.from_default_triple()
        self._machine = target.create_target_machine(cpu=name, features=flags, opt=2, jit=True)
        self.identity = f"{llvmlite.__version__} {target.triple} {name} {flags}"
        library = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)
        for function in sorted(set(LIBRARY.values())):
            symbol = getattr(library, function, None) or getattr(library, f"_{function}")
            binding.add_symbol(function, ctypes.cast(symbol, ctypes.c_void_p).value)
        self._engine = binding.create_mcjit_compiler(binding.parse_assembly(""), self._machine)
        self._addresses: dict[str, int] = {}
        self._lock = threading.Lock()

    def kernel(self, instructions: Sequence[Instruction]) -> Callable[..., None]:
        """The compiled function of instructions: from this process, from the cache on disk, or compiled now."""
        whole, pointer = ctypes.c_int64, ctypes.c_void_p
        return ctypes.CFUNCTYPE(None, whole, whole, pointer, pointer, pointer, whole)(
            self.address(intermediate(instructions, self.lanes)))

    def loop(self, shape: Shape, task: str) -> Callable[..., None]:
        """The compiled loop that does a task of calib.compiled.fused with rows."""
        types = [ctypes.c_int64] * 3 + [ctypes.c_void_p] * len(POINTERS[task])
        return ctypes.CFUNCTYPE(None, *types)(self.address(fused(shape, task, self.lanes)))

    def sparse(self, kind: Callable[[int], str], freedom: int) -> Callable[..., None]:
        """A compiled loop over small blocks, of calib.compiled.sparse."""
        types = [ctypes.c_int64] * len(sparse.NUMBERS) + [ctypes.c_void_p] * len(sparse.POINTERS)
        return ctypes.CFUNCTYPE(None, *types)(self.address(kind(freedom)))

    def address(self, text: str) -> int:
        """Where the function `rows` of LLVM IR stands, compiled or from a cache."""
        digest = hashlib.sha256(f"{self.identity}\n{text}".encode()).hexdigest()
        with self._lock:
            if digest not in self._addresses:
                self._addresses[digest] = self._loaded(text.replace("@rows(", f"@rows_{digest}("), digest)
            return self._addresses[digest]

    def _loaded(self, text: str, digest: str) -> int:
        folder = cache_folder()
        code = None if folder is None else _kept(folder / f"{digest}.rows")
        if code is None:
            module = self._binding.parse_assembly(text)
            module.triple = self._machine.triple
            code = self._machine.emit_object(module)
            if folder is not None:
                _keep(folder / f"{digest}.rows", code)
        self._engine.add_object_file(self._binding.ObjectFileRef.from_data(code))
        self._engine.finalize_object()
        return int(self._engine.get_function_address(f"rows_{digest}"))


@cache
def compiler() -> Compiler | None:
    """The compiler, None where llvmlite is not installed or does not know this machine."""
    try:
        return Compiler()
    except (ImportError, OSError, AttributeError, RuntimeError):
        return None
