# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What nobody means to send: damaged bytes, YAML and paths that are none, by random numbers."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from gtmr_study.faults.fault import Rng

T = TypeVar("T")
KEYS = ("sampling_time_s", "vehicle", "tower", "weights", "horizon", "kind", "radius_m", "nope")


def damaged(data: bytes, rng: Rng) -> bytes:
    """Flip bits, cut, lengthen, blank or exchange parts of some bytes, or send others instead."""
    raw = bytearray(data)
    how = int(rng.integers(8))
    at = int(rng.integers(len(raw) + 1)) if raw else 0
    if how == 0 and raw:
        for _ in range(int(rng.integers(1, 9))):
            raw[rng.integers(len(raw))] ^= 1 << int(rng.integers(8))
    elif how == 1:
        del raw[at:]
    elif how == 2:
        raw += rng.bytes(int(rng.integers(1, 200)))
    elif how == 3:
        raw[at : at + 64] = bytes(len(raw[at : at + 64]))
    elif how == 4:
        # Lengths, counts and seconds are four bytes each, and these the odd values of them.
        word = rng.choice([0xFFFFFFFF, 0x7FFFFFFF, 0x80000000, 0x00FFFFFF, 0])
        at -= at % 4
        raw[at : at + 4] = int(word).to_bytes(4, "little")
    elif how == 5:
        raw[at:at] = rng.bytes(int(rng.integers(1, 9)))
    elif how == 6:
        raw = bytearray(rng.bytes(int(rng.integers(0, 400))))
    else:
        # Numbers that are none, or far beyond any use.
        at -= at % 8
        odd = (
            b"\0\0\0\0\0\0\xf8\x7f",
            b"\0\0\0\0\0\0\xf0\x7f",
            b"\xff\xff\xff\xff\xff\xff\xef\x7f",
        )
        raw[at : at + 8] = odd[int(rng.integers(3))]
    return bytes(raw)


def yaml_text(template: str, rng: Rng) -> bytes:
    """Write YAML that cannot be used, or hardly: good one damaged, or one of the known tricks."""
    if rng.random() < 0.4:
        return damaged(template.encode(), rng)
    trick = _pick(_TRICKS, rng)
    return trick(rng)


def _aliases(rng: Rng) -> bytes:
    depth, width = int(rng.integers(3, 40)), int(rng.integers(2, 12))
    lines = ["a0: &a0 [1, 2]"]
    for k in range(1, depth):
        members = ", ".join([f"*a{k - 1}"] * width)
        lines.append(f"a{k}: &a{k} [{members}]")
    return "\n".join([*lines, f"{_pick(KEYS, rng)}: *a{depth - 1}"]).encode()


def _deep(rng: Rng) -> bytes:
    depth = int(rng.integers(50, 20000))
    left, right = _pick((("[", "]"), ("{a: ", "}")), rng)
    return (f"{_pick(KEYS, rng)}: " + left * depth + "1" + right * depth).encode()


def _endless(_: Rng) -> bytes:
    return b"&a [*a, *a]"


def _tagged(rng: Rng) -> bytes:
    tags = (
        "!!python/object/apply:os.system ['true']",
        "!!python/name:os.system",
        "!!binary '====='",
        "!!timestamp 9999-99-99",
        "!!set {a, b}",
        "!!int 'x'",
        "!!float 'x'",
        "!unknown x",
        "!!merge <<",
        "!!omap [1]",
    )
    return f"{_pick(KEYS, rng)}: {_pick(tags, rng)}\n".encode()


def _scalars(rng: Rng) -> bytes:
    values = (
        "9" * int(rng.integers(100, 10000)),
        "1e999",
        ".nan",
        "-.inf",
        "0x" + "f" * 500,
        "2026-13-45",
        "2026-02-30 25:61:61",
        "1:99:99",
        "~",
        "''",
        "'" + "x" * 100000 + "'",
        "[]",
        "{}",
        "{1: 2, [1, 2]: 3}",
        "? {a: b}\n: c",
        '"\\ud800"',
        '"\\x00"',
        "1_000_000_000_000_000_000_000_000",
        "0b1" + "0" * 2000,
    )
    return f"{_pick(KEYS, rng)}: {_pick(values, rng)}\n".encode()


def _keys(rng: Rng) -> bytes:
    keys = (
        "1",
        "~",
        "1.5",
        "[a]",
        "? [a]\n",
        "2026-01-01",
        "''",
        "true",
        "<<",
        "*x",
        "&x",
        "!!str",
    )
    return f"{_pick(keys, rng)}: {_pick(keys, rng)}\n".encode()


def _noise(rng: Rng) -> bytes:
    marks = list("{}[]:,&*#?|-<>=!%@`\"'\\\n\t \u0000\ufeff\u2028aZ09.~")
    return "".join(rng.choice(marks, int(rng.integers(0, 300)))).encode()


def _whole(rng: Rng) -> bytes:
    return _pick((b"", b"---\n---\n", b"a", b"- 1", b"%YAML 9.9\n---", b"\xff\xfe", b"\x00"), rng)


def _long(rng: Rng) -> bytes:
    return b"a: 1\n" * int(rng.integers(1, 400000))


_TRICKS: tuple[Callable[[Rng], bytes], ...] = (
    _aliases, _deep, _endless, _tagged, _scalars, _keys, _noise, _whole, _long,
)  # fmt: skip


def path_name(rng: Rng) -> str:
    """Name a file that cannot be written or read, or hardly."""
    length = int(rng.choice([1, 100, 255, 256, 1000, 4096, 10000]))
    names = (
        "x" * length,
        "/".join(["x" * 50] * (length // 50 + 1)),
        "\u00e4" * length,
        "/proc/x.json",
        "/proc/self/mem",
        "/sys/x.json",
        "/dev/null/x",
        "/dev/full",
        "\n",
        "..",
        "/",
        "",
        "~nobody/x",
        "\udcff.json",
        "-",
        "nowhere/x.json",
    )
    return _pick(names, rng)


def _pick(values: Sequence[T], rng: Rng) -> T:
    return values[int(rng.integers(len(values)))]
