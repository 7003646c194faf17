"""Load the machine code of kernels by LLVM, without numba, except for its C functions that the code calls.

Importing numba takes a quarter of the processor time of a short replay. Internal names of numba are used; if one is
missing, loading raises an exception, and numba loads or compiles the kernel.
"""

from __future__ import annotations

import builtins
import ctypes
import pickle
import sys
from collections.abc import Callable
from errno import EACCES
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from marshal import dumps, loads
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct
from msgspec.structs import astuple


class MachineCode(Struct, frozen=True):
    """An entry of the cache: an object file, or without ``wrapper`` what numba's own cache would store.

    ``wrapper`` is its function for Python, ``environment`` its variable for numba's constants, ``dtypes`` are the types
    of the arrays that it makes, and ``symbols`` the symbols that it leaves unresolved.
    """

    code: bytes
    wrapper: str = ""
    environment: str = ""
    dtypes: tuple[str, ...] = ()
    symbols: tuple[str, ...] = ()

    def pack(self) -> bytes:
        """Return the content of the entry's file."""
        return dumps(astuple(self))

    @classmethod
    def parse(cls, content: bytes | memoryview) -> MachineCode:
        """Parse the content of a file; raises ValueError, EOFError or TypeError if it is not valid."""
        return cls(*loads(content))  # noqa: S302  the checksum has been compared


def link(entry: MachineCode, module: str, name: str) -> Callable[..., Any]:
    """Return the function for Python of an object file; the caller must check that its arguments have the right types.

    Raises AttributeError, ImportError or LookupError if internals of numba are missing.
    """
    from llvmlite import binding as llvm  # noqa: PLC0415  commands without kernels do without

    engine, dynamic = _engine(), _extension("_dynfunc")
    for symbol in entry.symbols:
        _define(symbol)
    engine.add_object_file(llvm.ObjectFileRef.from_data(entry.code))
    address = engine.get_function_address(entry.wrapper)  # MCJIT finalizes the object before it gives its address
    if not address:
        raise LookupError(entry.wrapper)
    environment = dynamic.Environment({})
    environment.consts[:] = map(np.dtype, entry.dtypes)
    if variable := engine.get_global_value_address(entry.environment):
        ctypes.c_void_p.from_address(variable).value = id(environment)
    kept = (engine, environment)
    made: Callable[..., Any] = dynamic.make_function(sys.modules[module], name, name, address, environment, kept)
    return made


@cache
def check_executable() -> None:
    """Raise PermissionError where memory cannot be made executable, as under systemd's MemoryDenyWriteExecute."""
    from llvmlite import binding as llvm  # noqa: PLC0415

    try:
        llvm.check_jit_execution()
    except OSError as error:
        advice = "allow it (systemd: MemoryDenyWriteExecute=no, SELinux: execmem)"
        text = f"compiled code needs executable memory, which this system denies to mavnav; {advice}"
        raise PermissionError(EACCES, text) from error


@cache
def _engine() -> Any:  # noqa: ANN401
    from llvmlite import binding as llvm  # noqa: PLC0415

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(jit=True)
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)


@cache
def _define(symbol: str) -> None:
    """Tell LLVM the address of a symbol; without it LLVM would end the process. Raises LookupError."""
    from llvmlite import binding as llvm  # noqa: PLC0415

    llvm.add_symbol(symbol, _address(symbol))


def _address(symbol: str) -> int:
    """Return the address of what machine code calls a symbol; raises LookupError."""
    if symbol in (known := _c_functions()):
        return known[symbol]
    if symbol.startswith("PyExc_"):
        return id(getattr(builtins, symbol.removeprefix("PyExc_")))
    try:
        return _address_of(getattr(ctypes.pythonapi, symbol))
    except AttributeError:
        raise LookupError(symbol) from None


@cache
def _c_functions() -> dict[str, int]:
    """Return the addresses of numba's C functions by the names that numba gives them in machine code."""
    helpers: dict[str, int] = _extension("_helperlib").c_helpers  # mathematical ones have their own names
    memory = _extension("core.runtime._nrt_python").c_helpers
    known = {f"numba_{name}": address for name, address in {**helpers, **_extension("_dynfunc").c_helpers}.items()}
    known |= {name if name.startswith("_") else f"NRT_{name}": address for name, address in memory.items()}
    return helpers | known | {"_Py_NoneStruct": id(None), "numba_unpickle": _address_of(_UNPICKLE)}


@cache
def _object_at(content: int, size: int, _digest: int) -> Any:  # noqa: ANN401
    return pickle.loads(ctypes.string_at(content, size))  # noqa: S301  a part of the machine code


_UNPICKLE = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p)(_object_at)
"""What machine code calls for the type of an array that it returns; numba's own function imports numba for it.

After the first call the cache answers in C: a signal handler of Python, which may raise, cannot run in between. In the
first call it cannot either, because that is not made in the main thread.
"""


def _address_of(function: Any) -> int:  # noqa: ANN401
    return ctypes.cast(function, ctypes.c_void_p).value or 0


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
