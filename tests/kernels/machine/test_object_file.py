"""Images of object files: their code runs where it is copied to, and files of other kinds are refused."""

from __future__ import annotations

import ctypes
import platform
import sys
from struct import pack, pack_into, unpack_from

import llvmlite.binding as llvm
import pytest

from mavnav.kernels.machine.image import placed
from mavnav.kernels.machine.object_file import image_of

pytestmark = [
    pytest.mark.skipif(
        sys.platform != "linux" or platform.machine() != "x86_64", reason="images are made for Linux on x86-64 alone"
    ),
    pytest.mark.skipif(llvm.llvm_version_info < (16,), reason="older versions read pointers with types"),
]

SOURCE = """
@counter = global i64 40
@table = internal constant [3 x ptr] [ptr @one, ptr @two, ptr @other]
@empty = common global i64 0, align 32
declare i64 @other(i64)
define i64 @one(i64 %x) { %y = add i64 %x, 1
  ret i64 %y }
define i64 @two(i64 %x) { %y = add i64 %x, 2
  ret i64 %y }
define i64 @chosen(i64 %k, i64 %x) {
  %place = getelementptr [3 x ptr], ptr @table, i64 0, i64 %k
  %function = load ptr, ptr %place
  %y = call i64 %function(i64 %x)
  %before = load i64, ptr @counter
  %after = add i64 %before, 1
  store i64 %after, ptr @counter
  store i64 %y, ptr @empty
  %sum = add i64 %y, %after
  ret i64 %sum }
"""


@pytest.fixture(scope="module")
def code() -> bytes:
    """Return an object file as numba makes them: absolute addresses, large code model."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_triple(llvm.get_process_triple())
    machine = target.create_target_machine(reloc="static", codemodel="large", jit=True)
    return machine.emit_object(llvm.parse_assembly(SOURCE))


def test_the_code_of_an_image_runs_where_it_is_copied_to(code: bytes) -> None:
    image = image_of(code, {"chosen", "counter", "empty", "unknown"})
    assert image.offsets.keys() == {"chosen", "counter", "empty"}
    assert set(image.outer) == {"other"}
    assert image.offsets["chosen"] < image.writable <= min(image.offsets["counter"], image.offsets["empty"])
    assert image.offsets["empty"] % 32 == 0
    other = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64)(lambda x: 10 * x)
    address = ctypes.cast(other, ctypes.c_void_p).value or 0
    for _ in range(2):  # each copy has variables of its own
        memory, start = placed(image, {"other": address}.__getitem__)
        chosen = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_int64)(start + image.offsets["chosen"])
        assert [chosen(k, 7) for k in range(3)] == [8 + 41, 9 + 42, 70 + 43]
        assert ctypes.c_int64.from_address(start + image.offsets["counter"]).value == 43
        assert ctypes.c_int64.from_address(start + image.offsets["empty"]).value == 70
        assert len(memory) >= len(image.content)


def test_a_symbol_that_nobody_knows_is_an_error(code: bytes) -> None:
    with pytest.raises(KeyError):
        placed(image_of(code, {"chosen"}), {}.__getitem__)


def test_files_of_other_kinds_are_refused(code: bytes) -> None:
    for wrong in (
        b"",
        b"MZ" + code[2:],
        code[:18] + pack("<H", 183) + code[20:],
        code[:16] + pack("<H", 3) + code[18:],
    ):
        with pytest.raises(ValueError, match="not an object file"):
            image_of(wrong, ())


def test_other_relocations_are_refused(code: bytes) -> None:
    changed = bytearray(code)
    start, count = unpack_from("<Q", code, 40)[0], unpack_from("<H", code, 60)[0]
    for k in range(count):
        _, kind, _, _, offset, size = unpack_from("<IIQQQQ", code, start + 64 * k)
        if kind == 4 and size:
            (info,) = unpack_from("<Q", code, offset + 8)
            pack_into("<Q", changed, offset + 8, info & ~0xFFFFFFFF | 2)
    with pytest.raises(ValueError, match="a relocation of kind 2"):
        image_of(bytes(changed), ())
