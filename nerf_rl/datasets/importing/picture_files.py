"""Pictures that somebody handed in: PNG and JPEG files, decoded after a look at their sizes.

A small file may claim, and truly decode to, a picture of gigabytes, so the size is read from its head first.
"""

import os
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, UInt8
from numpy import ndarray

from nerf_rl.datasets.importing.faults import SourceError

_MOST_BYTES = 1 << 28  # of a file
MOST_PIXELS = 1 << 26
"""of a picture"""
_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"
_PNG_HEAD, _PNG_DEPTH, _PNG_COLOUR_TYPE = 29, 24, 25  # bytes of signature and header without its checksum, places in it
_WITH_ALPHA = (4, 6)
_MOST_CHUNKS = 1000
_MOST_COLOURS = 256  # of a palette
_FRAMES = frozenset({*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC})  # JPEG's markers with a size


def read_colours(path: Path, height: int, width: int) -> UInt8[ndarray, "H W 3"]:
    """Return the RGB colours of a picture of known size; what EXIF says of turning it is left alone.

    Raises:
        SourceError: it is no such picture.
    """
    decoded = _decoded(path, height, width, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    return np.ascontiguousarray(decoded[..., ::-1])


def has_alpha(path: Path) -> bool:
    """Tell whether a picture says how opaque its pixels are: PNG files may, of which only the head is read."""
    header, transparent = _png_head(path)
    return transparent is not None or (header != b"" and header[_PNG_COLOUR_TYPE] in _WITH_ALPHA)


def _transparent_grey(path: Path) -> int | None:
    """Return what a grey pixel that is seen through is decoded to; None if no such pixels are told of."""
    header, transparent = _png_head(path)
    if transparent is None or len(transparent) < 2:
        return None
    bits = header[_PNG_DEPTH]
    (grey,) = struct.unpack(">H", transparent[:2])
    return int(grey if bits >= 8 else grey * 255 // (2**bits - 1))


def _png_head(path: Path) -> tuple[bytes, bytes | None]:
    """Return a PNG file's signature and header, and what it says of the opacity of colours that have none of their own.

    Of another file nothing is returned, and None of one that says nothing.
    """
    with open(path, "rb") as file:
        header = file.read(_PNG_HEAD)
        if not header.startswith(_PNG) or len(header) < _PNG_HEAD:
            return b"", None
        for _ in range(_MOST_CHUNKS):  # one that gives colours of other pictures an opacity comes before the pixels
            file.seek(4, os.SEEK_CUR)  # over the checksum of the last one
            chunk = file.read(8)
            if len(chunk) < 8 or chunk[4:] == b"IDAT":
                break
            size = struct.unpack(">I", chunk[:4])[0]
            if chunk[4:] == b"tRNS":
                return header, file.read(min(size, _MOST_COLOURS))
            file.seek(size, os.SEEK_CUR)
    return header, None


def read_opaque(path: Path, height: int, width: int) -> Bool[ndarray, "H W"]:
    """Tell which pixels of a picture of known size are opaque at least by half.

    Raises:
        SourceError: it is no such picture.
    """
    decoded = _decoded(path, height, width, cv2.IMREAD_UNCHANGED)
    if decoded.ndim == 2 and (grey := _transparent_grey(path)) is not None:  # which OpenCV leaves unread
        return decoded != grey
    if decoded.ndim != 3 or decoded.shape[2] != 4:
        return np.ones((height, width), bool)
    return decoded[..., 3] > np.iinfo(decoded.dtype).max // 2


def read_numbers(path: Path, height: int, width: int, dtype: type) -> ndarray:
    """Return the numbers [H, W] of a grey picture of known size.

    Args:
        path: of the picture.
        height, width: that it must have [pixels].
        dtype: that it must have: u8 or u16.

    Raises:
        SourceError: it is no such picture.
    """
    decoded = _decoded(path, height, width, cv2.IMREAD_UNCHANGED)
    if decoded.ndim != 2 or decoded.dtype != dtype:
        channels, bits = decoded.shape[2] if decoded.ndim == 3 else 1, 8 * decoded.dtype.itemsize
        wanted = f"one of {8 * np.dtype(dtype).itemsize} bits"
        raise SourceError(path, f"it has {channels} channels of {bits} bits instead of {wanted}")
    return decoded


def picture_size(path: Path) -> tuple[int, int]:
    """Return height and width of a picture [pixels].

    Raises:
        SourceError: it is neither a PNG nor a JPEG file, or too large.
    """
    with open(path, "rb") as file:
        return _size(path, file.read(1 << 20))


def _decoded(path: Path, height: int, width: int, flags: int) -> ndarray:
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise SourceError(path, f"it is larger than {_MOST_BYTES} bytes")
        content = path.read_bytes()
    except OSError as error:
        raise SourceError(path, f"it cannot be read ({error.strerror})") from error
    found = _size(path, content)
    if found != (height, width):
        raise SourceError(path, f"it is {found[1]} x {found[0]} pixels large instead of {width} x {height}")
    if content.startswith(_PNG) and not _is_whole_png(content):  # decoders make do with what there is
        raise SourceError(path, "its picture is damaged")
    try:
        decoded = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error as error:
        raise SourceError(path, "its picture is damaged") from error
    if decoded is None or decoded.shape[:2] != found:
        raise SourceError(path, "its picture is damaged")
    return decoded


def _size(path: Path, content: bytes) -> tuple[int, int]:
    found = None
    if content.startswith(_PNG) and content[12:16] == b"IHDR" and len(content) >= 24:
        width, height = struct.unpack(">II", content[16:24])
        found = height, width
    elif content.startswith(_JPEG):
        found = _jpeg_size(content)
    if found is None:
        raise SourceError(path, "it is neither a PNG nor a JPEG file")
    if not 0 < found[0] * found[1] <= MOST_PIXELS:
        raise SourceError(path, f"it claims {found[1]} x {found[0]} pixels; at most {MOST_PIXELS} are read")
    return found


def _is_whole_png(content: bytes) -> bool:
    """Tell whether all chunks of a PNG file, up to the one that ends it, have their checksums."""
    place = len(_PNG)
    while place + 12 <= len(content):
        end = place + 8 + struct.unpack(">I", content[place : place + 4])[0]
        kind = content[place + 4 : place + 8]
        if content[end : end + 4] != struct.pack(">I", zlib.crc32(content[place + 4 : end])):
            return False
        if kind == b"IEND":
            return True
        place = end + 4
    return False


def _jpeg_size(content: bytes) -> tuple[int, int] | None:
    """Return the height and width in a JPEG file's frame header, which follows other segments; None without."""
    place = 2
    while place + 9 <= len(content) and content[place] == 0xFF:
        marker = content[place + 1]
        if marker == 0xFF:  # filling
            place += 1
            continue
        if marker in _FRAMES:
            return struct.unpack(">HH", content[place + 5 : place + 9])
        place += 2 + struct.unpack(">H", content[place + 2 : place + 4])[0]
    return None
