"""Load the machine code of kernels with LLVM and numba's C runtime, without the rest of numba.

Importing numba takes 0.2 s of processor time, this module 0.04. It uses internal names of numba; if one is missing,
`loaded` raises, and numba loads or compiles the kernel.
"""

from __future__ import annotations

import builtins
import ctypes
import os
import pickle
import sys
from functools import cache
from hashlib import sha256
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.metadata import version
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from marshal import dumps, loads
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import Struct
from msgspec.structs import astuple

if TYPE_CHECKING:
    from collections.abc import Callable


class MachineCode(Struct, frozen=True):
    """An entry of the cache.

    ``code`` is an object file, ``wrapper`` its function for Python, ``environment`` its variable for numba's constants,
    ``dtypes`` the types of the arrays that it makes, ``symbols`` its unresolved symbols, and ``rest`` the additional
    data for loading it with numba. Without ``wrapper`` only numba can load it.
    """

    code: bytes
    wrapper: str
    environment: str
    dtypes: tuple[str, ...]
    symbols: tuple[str, ...]
    rest: bytes

    def packed(self) -> bytes:
        """Return the content of the entry's file."""
        return dumps(astuple(self))

    @classmethod
    def unpacked(cls, content: bytes | memoryview) -> MachineCode:
        """Parse the content of a file; raises ValueError, EOFError or TypeError if it is not valid."""
        return cls(*loads(content))  # noqa: S302  the checksum has been compared


@cache
def cache_key() -> str:
    """Return a key of what machine code depends on besides its source: numba, Python, the system and the processor."""
    llvm = _llvm()
    names = ("CPU_NAME", "CPU_FEATURES", "OPT", "ENABLE_AVX", "BOUNDSCHECK")
    chosen = [os.environ.get(f"NUMBA_{name}", "") for name in names]
    processor = [llvm.get_process_triple(), llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten(), *chosen]
    digest = sha256(repr(processor).encode()).hexdigest()[:16]
    return f"numba-{version('numba')}-py{sys.version_info.major}{sys.version_info.minor}-{digest}"


def loaded(entry: MachineCode, module: str, name: str) -> Callable[..., Any]:
    """Return the function for Python; the caller must check that its arguments have the types of the kernel.

    Raises AttributeError, ImportError, LookupError, OSError or RuntimeError if internals of numba are missing.
    """
    llvm, engine, runtime = _llvm(), _engine(), _runtime()
    for symbol in entry.symbols:
        _resolve(symbol)
    if not entry.wrapper:
        raise LookupError("numba alone can load it")
    engine.add_object_file(llvm.ObjectFileRef.from_data(entry.code))
    address = engine.get_function_address(entry.wrapper)  # MCJIT finalizes the object before it gives its address
    if not address:
        raise LookupError(entry.wrapper)
    environment = runtime.Environment({})
    environment.consts[:] = map(np.dtype, entry.dtypes)
    if variable := engine.get_global_value_address(entry.environment):
        ctypes.c_void_p.from_address(variable).value = id(environment)
    made: Callable[..., Any] = runtime.make_function(
        sys.modules[module], name, name, address, environment, (engine, environment)
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
def _runtime() -> Any:  # noqa: ANN401
    """Register numba's C functions in LLVM under the names that numba gives them; return ``_dynfunc``."""
    add_symbol, dynamic = _llvm().add_symbol, _extension("_dynfunc")
    helpers, memory = _helpers(), _extension("core.runtime._nrt_python").c_helpers
    known = {f"numba_{name}": address for name, address in {**helpers, **dynamic.c_helpers}.items()}
    known |= {name if name.startswith("_") else f"NRT_{name}": address for name, address in memory.items()}
    for name, address in known.items():
        add_symbol(name, address)
    add_symbol("_Py_NoneStruct", id(None))
    _set_unpickling(helpers["unpickle"])
    return dynamic


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


def _helpers() -> dict[str, int]:
    """Return the addresses of numba's C functions, mathematical ones under their own names."""
    helpers: dict[str, int] = _extension("_helperlib").c_helpers
    return helpers


@cache
def _extension(name: str) -> Any:  # noqa: ANN401
    """Import an extension module of numba, but not numba."""
    full = f"numba.{name}"
    if full in sys.modules:
        return sys.modules[full]
    (root,) = getattr(find_spec("numba"), "submodule_search_locations", None) or [""]
    path = Path(root, *name.split(".")).with_suffix(EXTENSION_SUFFIXES[0])
    spec = spec_from_file_location(full, path)
    if spec is None or spec.loader is None:
        raise ImportError(full)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def _resolve(symbol: str) -> None:
    """Register the address of a symbol in LLVM, which would end the process without it; raises LookupError."""
    llvm, helpers = _llvm(), _helpers()
    if symbol in helpers:
        llvm.add_symbol(symbol, helpers[symbol])
    elif symbol.startswith("PyExc_"):
        llvm.add_symbol(symbol, id(getattr(builtins, symbol.removeprefix("PyExc_"))))
    elif llvm.address_of_symbol(symbol) is None:
        raise LookupError(symbol)
