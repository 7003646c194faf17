"""Object files as images: their sections, and the places of addresses in them.

Understood is what LLVM makes for 64-bit x86 on Linux: ELF whose only relocations are absolute addresses (System V ABI,
AMD64 supplement).
"""

from __future__ import annotations

from struct import iter_unpack, unpack_from
from typing import TYPE_CHECKING, Final, NamedTuple

from mavnav.kernels.machine.image import Image

if TYPE_CHECKING:
    from collections.abc import Collection

    from mavnav.kernels.machine.image import Address

_ELF_64: Final = b"\x7fELF\x02\x01\x01"
_RELOCATABLE: Final = (1, 62)
"""Kind of file, and number of the processor."""
_SYMBOLS, _RELOCATIONS, _ZEROS, _UNWINDING = 2, 4, 8, 0x70000001
"""Kinds of sections; the last is for stack traces through machine code, which nothing here needs."""
_WRITABLE, _IN_MEMORY = 1, 2
_COMMON: Final = (0xFFF2, 0xFF02)
"""Numbers of sections for variables without a place."""
_ABSOLUTE: Final = 1
"""Kind of relocation: the address of a symbol plus a number, 64 bits."""
_PAGE_BYTES: Final = 4096


class _Section(NamedTuple):
    name: int
    kind: int
    flags: int
    address: int
    start: int
    size: int
    link: int
    about: int
    alignment: int
    entry_size: int


class _Symbol(NamedTuple):
    name: str
    section: int
    value: int
    size: int


def image_of(code: bytes, wanted: Collection[str]) -> Image:
    """Make an image of an object file, with the offsets of those ``wanted`` symbols that it defines.

    Raises ValueError if the object file is not one of those that are understood.
    """
    if code[:7] != _ELF_64 or unpack_from("<HH", code, 16) != _RELOCATABLE:
        raise ValueError("not an object file in ELF for x86-64")
    (start,), (count,) = unpack_from("<Q", code, 40), unpack_from("<H", code, 60)
    sections = [_Section(*fields) for fields in iter_unpack("<IIQQQQIIQQ", code[start : start + 64 * count])]
    symbols = _symbols(code, sections)
    content, writable, places = _laid_out(code, sections)
    offsets: dict[int, int] = {}
    for k, symbol in enumerate(symbols):
        if symbol.section in places:
            offsets[k] = places[symbol.section] + symbol.value
        elif symbol.section in _COMMON:  # whose value is their alignment
            content += bytes(-len(content) % symbol.value)
            offsets[k] = len(content)
            content += bytes(symbol.size)
    inner: list[Address] = []
    outer: dict[str, list[Address]] = {}
    for section in sections:
        if section.kind != _RELOCATIONS or section.about not in places:
            continue
        for where, info, addend in iter_unpack("<QQq", _content(code, section)):
            k, kind = info >> 32, info & 0xFFFFFFFF
            if kind != _ABSOLUTE:
                raise ValueError(f"a relocation of kind {kind}")
            at = places[section.about] + where
            if k in offsets:
                inner.append((at, offsets[k] + addend))
            else:
                outer.setdefault(symbols[k].name, []).append((at, addend))
    named = {symbol.name: offsets[k] for k, symbol in enumerate(symbols) if symbol.name in wanted and k in offsets}
    return Image(bytes(content), writable, named, tuple(inner), {name: tuple(at) for name, at in outer.items()})


def _content(code: bytes, section: _Section) -> bytes:
    return code[section.start : section.start + section.size]


def _symbols(code: bytes, sections: list[_Section]) -> list[_Symbol]:
    (table,) = (section for section in sections if section.kind == _SYMBOLS)
    names = _content(code, sections[table.link])
    return [
        _Symbol(names[name : names.index(0, name)].decode(), section, value, size)
        for name, _, _, section, value, size in iter_unpack("<IBBHQQ", _content(code, table))
    ]


def _laid_out(code: bytes, sections: list[_Section]) -> tuple[bytearray, int, dict[int, int]]:
    """Return the sections one after another, the offset of the writable ones, and the offset of each by its number."""
    content, places = bytearray(), {}
    for writable in (0, _WRITABLE):
        content += bytes(-len(content) % _PAGE_BYTES)
        begin = len(content)
        for k, section in enumerate(sections):
            if section.flags & _IN_MEMORY and section.kind != _UNWINDING and section.flags & _WRITABLE == writable:
                content += bytes(-len(content) % max(section.alignment, 1))
                places[k] = len(content)
                content += bytes(section.size) if section.kind == _ZEROS else _content(code, section)
    return content, begin, places
