"""EDID: a monitor's identity and native resolution, from the 128 bytes that it sends over its cable."""

from dataclasses import dataclass

from optolever.errors import InputError

__all__ = ["Edid", "parse_edid"]

_HEADER = bytes.fromhex("00ffffffffffff00")
_NAME, _SERIAL = 0xFC, 0xFF  # tags of display descriptors


@dataclass(frozen=True, slots=True)
class Edid:
    """maker: three letters; name, serial: "" where absent; rows, cols: of its native mode; height_mm,
    width_mm: of its image. 0 is unknown.
    """

    maker: str
    name: str
    serial: str
    rows: int
    cols: int
    height_mm: int
    width_mm: int


def parse_edid(data: bytes) -> Edid:
    """The base block (VESA E-EDID 1.3 and 1.4). InputError of bytes that are none, or whose sum is wrong."""
    if len(data) < 128 or data[:8] != _HEADER:
        raise InputError(f"EDID: {len(data)} bytes, {data[:8].hex()}..., must be 128, {_HEADER.hex()}...")
    block = data[:128]
    if sum(block) % 256:
        raise InputError(
            f"EDID: the bytes add up to {sum(block) % 256}, must be 0 (mod 256): a damaged reading"
        )
    code = int.from_bytes(block[8:10], "big")
    maker = "".join(chr(64 + (code >> shift & 31)) for shift in (10, 5, 0))
    number = int.from_bytes(block[12:16], "little")
    texts = {_NAME: "", _SERIAL: str(number) if number else ""}
    rows = cols = height = width = 0
    for start in range(54, 126, 18):
        entry = block[start : start + 18]
        if entry[:2] != b"\0\0":
            if not cols:  # the first detailed timing is the preferred one
                cols, rows = entry[2] | (entry[4] & 0xF0) << 4, entry[5] | (entry[7] & 0xF0) << 4
                width, height = entry[12] | (entry[14] & 0xF0) << 4, entry[13] | (entry[14] & 0x0F) << 8
        elif entry[3] in texts:
            texts[entry[3]] = entry[5:18].split(b"\n")[0].decode("cp437").strip()
    if not width:
        width, height = 10 * block[21], 10 * block[22]
    return Edid(maker, texts[_NAME], texts[_SERIAL], rows, cols, height, width)
