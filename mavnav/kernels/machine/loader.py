"""Load the machine code of kernels without numba, except for its C functions that the code calls.

Importing numba takes 0.2 s of processor time, LLVM 0.04. Where possible the code is an image, which needs neither. Both
ways use internal names of numba; if one is missing, they raise, and numba loads or compiles the kernel.
"""

from __future__ import annotations

import builtins
import ctypes
import os
import pickle
import platform
import sys
from functools import cache
from hashlib import sha256
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from marshal import dumps, loads
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import astuple

from mavnav.kernels.machine.image import Image, placed

if TYPE_CHECKING:
    from collections.abc import Callable


class MachineCode(Struct, frozen=True):
    """An entry of the cache: an image if possible, else an object file.

    ``wrapper`` is its function for Python, ``environment`` its variable for numba's constants, ``dtypes`` are the types
    of the arrays that it makes, and ``image`` are the fields of its `Image`. ``code`` is the object file, ``symbols``
    are its unresolved symbols, and ``rest`` is the additional data for loading it with numba. Without ``wrapper`` only
    numba can load it.
    """

    wrapper: str = ""
    environment: str = ""
    dtypes: tuple[str, ...] = ()
    image: tuple[Any, ...] | None = None
    code: bytes = b""
    symbols: tuple[str, ...] = ()
    rest: bytes = b""

    def packed(self) -> bytes:
        """Return the content of the entry's file."""
        return dumps(astuple(self))

    @classmethod
    def unpacked(cls, content: bytes | memoryview) -> MachineCode:
        """Parse the content of a file; raises ValueError, EOFError or TypeError if it is not valid."""
        return cls(*loads(content))  # noqa: S302  the checksum has been compared


_CPUINFO: Final = Path("/proc/cpuinfo")
_OF_PROCESSOR: Final = ("vendor_id", "cpu family", "model", "flags", "CPU implementer", "CPU part", "Features")
"""Its lines that say what code a processor runs."""
_INSTRUCTIONS: Final = (
    "sse", "ssse", "avx", "amx", "fma", "f16c", "bmi", "abm", "popcnt", "movbe", "adx", "aes", "pclmul", "vaes",
    "vpclmul", "gfni", "sha", "xop", "tbm", "cx16", "lahf",
)  # fmt: skip
"""Beginnings of the flags for instructions that compilers use; the others change with the kernel of the system."""


@cache
def cache_key() -> str:
    """Return a key of what machine code depends on besides its source: numba, Python, the system and the processor."""
    names = ("CPU_NAME", "CPU_FEATURES", "OPT", "ENABLE_AVX", "BOUNDSCHECK")
    chosen = [os.environ.get(f"NUMBA_{name}", "") for name in names]
    digest = sha256(repr([sys.platform, platform.machine(), _processor(), *chosen]).encode()).hexdigest()[:16]
    return f"numba-{_version()}-py{sys.version_info.major}{sys.version_info.minor}-{digest}"


def _processor() -> list[str]:
    """Return what the system says of the first processor, or LLVM where it names no instruction sets."""
    try:
        with _CPUINFO.open(encoding="utf-8", errors="replace") as file:
            first = file.read(1 << 14).partition("\n\n")[0]
    except OSError:
        first = ""
    lines = {name.strip(): value.split() for name, _, value in (line.partition(":") for line in first.splitlines())}
    known = [f"{name}: {lines[name]}" for name in _OF_PROCESSOR if name in lines and name != "flags"]
    known += [flag for flag in lines.get("flags", ()) if flag.startswith(_INSTRUCTIONS)]
    llvm = None if {"flags", "Features"} & lines.keys() else _llvm()
    return [llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()] if llvm else known


def _version() -> str:
    """Return the version of numba, from the name of the folder beside it: importlib.metadata takes 15 ms to import."""
    folders = [path.stem for path in _root().parent.glob("numba-*.dist-info")]
    if len(folders) == 1:
        return folders[0].removeprefix("numba-")
    from importlib.metadata import version  # noqa: PLC0415

    return version("numba")


def copied(entry: MachineCode, module: str, name: str) -> Callable[..., Any]:
    """Return the function for Python of an image; the caller must check that its arguments have the kernel's types.

    Raises AttributeError, ImportError, LookupError or OSError if there is no image, if internals of numba are missing,
    or if the system does not allow it.
    """
    if entry.image is None:
        raise LookupError("no image")
    image = Image(*entry.image)
    memory, start = placed(image, _address)
    variable = image.offsets.get(entry.environment)
    address = start + image.offsets[entry.wrapper]
    return _function(entry, module, name, address, None if variable is None else start + variable, memory)


def linked(entry: MachineCode, module: str, name: str) -> Callable[..., Any]:
    """Return the function for Python of an object file, loaded by LLVM; otherwise like `copied`."""
    if not (entry.wrapper and entry.code):
        raise LookupError("only an image, or only numba can load it")
    llvm, engine = _llvm(), _engine()
    for symbol in entry.symbols:
        llvm.add_symbol(symbol, _address(symbol))  # LLVM would end the process without it
    engine.add_object_file(llvm.ObjectFileRef.from_data(entry.code))
    address = engine.get_function_address(entry.wrapper)  # MCJIT finalizes the object before it gives its address
    if not address:
        raise LookupError(entry.wrapper)
    return _function(entry, module, name, address, engine.get_global_value_address(entry.environment), engine)


def _function(
    entry: MachineCode, module: str, name: str, address: int, variable: int | None, kept: object
) -> Callable[..., Any]:
    """Make the function for Python at an address, and store its constants in the variable for them.

    ``kept`` is what must live as long as the function.
    """
    dynamic = _extension("_dynfunc")
    environment = dynamic.Environment({})
    environment.consts[:] = map(np.dtype, entry.dtypes)
    if variable:
        ctypes.c_void_p.from_address(variable).value = id(environment)
    made: Callable[..., Any] = dynamic.make_function(
        sys.modules[module], name, name, address, environment, (kept, environment)
    )
    return made


@cache
def _llvm() -> Any:  # noqa: ANN401
    from llvmlite import binding  # noqa: PLC0415

    return binding


@cache
def _engine() -> Any:  # noqa: ANN401
    llvm = _llvm()
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(jit=True)
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)


@cache
def _address(symbol: str) -> int:
    """Return the address of what machine code calls a symbol; raises LookupError."""
    if symbol in (known := _numbas()):
        return known[symbol]
    if symbol.startswith("PyExc_"):
        return id(getattr(builtins, symbol.removeprefix("PyExc_")))
    try:
        return ctypes.cast(getattr(ctypes.pythonapi, symbol), ctypes.c_void_p).value or 0
    except AttributeError:
        raise LookupError(symbol) from None


@cache
def _numbas() -> dict[str, int]:
    """Return the addresses of numba's C functions by the names that numba gives them in machine code."""
    helpers: dict[str, int] = _extension("_helperlib").c_helpers  # mathematical ones have their own names
    memory = _extension("core.runtime._nrt_python").c_helpers
    known = {f"numba_{name}": address for name, address in {**helpers, **_extension("_dynfunc").c_helpers}.items()}
    known |= {name if name.startswith("_") else f"NRT_{name}": address for name, address in memory.items()}
    _set_unpickling(helpers["unpickle"])
    return helpers | known | {"_Py_NoneStruct": id(None)}


def _set_unpickling(address: int) -> None:
    """Make numba's C function call `_unpickled`, instead of a function for which it would import numba."""
    if "numba" in sys.modules:
        return
    name = "numba.core.serialize"
    stand_ins = {"numba": ModuleType("numba"), name: ModuleType(name)}
    stand_ins[name].__dict__["_numba_unpickle"] = lambda _address, content, _digest: _unpickled(content)
    sys.modules.update(stand_ins)
    try:
        content = pickle.dumps(None)
        unpickle = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p)(address)
        unpickle(content, len(content), bytes(range(1, 33)))
    finally:
        for stand_in in stand_ins:
            del sys.modules[stand_in]


@cache
def _unpickled(content: bytes) -> Any:  # noqa: ANN401
    return pickle.loads(content)  # noqa: S301  a part of the machine code


@cache
def _extension(name: str) -> Any:  # noqa: ANN401
    """Import an extension module of numba, but not numba."""
    full = f"numba.{name}"
    if full in sys.modules:
        return sys.modules[full]
    path = _root().joinpath(*name.split(".")).with_suffix(EXTENSION_SUFFIXES[0])
    spec = spec_from_file_location(full, path)
    if spec is None or spec.loader is None:
        raise ImportError(full)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def _root() -> Path:
    """Return the folder of numba, which is not imported for it."""
    (root,) = getattr(find_spec("numba"), "submodule_search_locations", None) or [""]
    return Path(root)
