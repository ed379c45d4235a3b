"""Changes of texts: TOML, JSON, journals of JSON lines, headers of PLY."""

import json
import random
import re
from typing import Any

from .nasty import TEXTS, nasty_number, nasty_text, nasty_value, near, pick


def change_bytes(rng: random.Random, data: bytes) -> bytes:
    """A file cut short, with bytes flipped, put in, or left out."""
    if not data:
        return b"\xff"
    at, some = rng.randrange(len(data)), rng.randbytes(rng.choice((1, 2, 40)))
    return pick(
        rng,
        lambda: data[:at],
        lambda: data[:at] + some + data[at + len(some) :],
        lambda: data[:at] + some + data[at:],
        lambda: data[:at] + data[at + len(some) :],
        lambda: data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :],
        lambda: data + data,
        lambda: rng.choice((b"", b"\0" * len(data), data[at:], b"\xef\xbb\xbf" + data, data + b"\0" * 4096)),
    )


def change_lines(rng: random.Random, data: bytes) -> bytes:
    """A line left out, doubled, or moved."""
    lines = data.splitlines(keepends=True) or [b"\n"]
    one, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    line = lines[one] if rng.random() < 0.3 else lines.pop(one)
    lines[other:other] = rng.choice(([], [line], [line]))
    return b"".join(lines)


def change_tree(rng: random.Random, value: Any) -> Any:
    """A JSON value in which one place, anywhere in it, is changed."""
    places = list(_places(value))
    if not places:
        return nasty_value(rng)
    parent, key = rng.choice(places)
    old = parent[key]
    kind = rng.randrange(8)
    if kind in (2, 3) and isinstance(old, int | float) and not isinstance(old, bool):
        parent[key] = near(rng, old)
    elif kind == 4:
        del parent[key]
    elif kind == 5 and isinstance(parent, dict):
        parent[rng.choice((key + "x", key[:-1], key.upper(), nasty_text(rng)))] = parent.pop(key)
    elif kind == 6:
        other, name = rng.choice(places)
        parent[key], other[name] = other[name], old
    elif kind == 7 and isinstance(parent, dict):
        parent[nasty_text(rng)] = nasty_value(rng)
    else:
        parent[key] = nasty_value(rng)
    # An exchange may have put a table into itself.
    return nasty_value(rng) if _depth(value) > 200 else value


def change_json(rng: random.Random, data: bytes) -> bytes:
    """A JSON file with one to three places changed, or its bytes."""
    if rng.random() < 0.15:
        return change_bytes(rng, data)
    value = json.loads(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        value = change_tree(rng, value)
    return dump(value)


def dump(value: Any) -> bytes:
    """JSON as a careless program writes it: with NaN, and half a surrogate pair as an escape."""
    return json.dumps(value).encode()


def change_journal(rng: random.Random, data: bytes) -> bytes:
    """A journal with a line or a value changed, or with another end."""
    kind = rng.randrange(9)
    if kind < 3:
        return rng.choice((change_bytes, change_lines))(rng, data)
    lines = data.splitlines()
    at = rng.randrange(len(lines)) if lines else 0
    if kind == 3:
        lines.insert(at, rng.choice(_STRANGE_LINES))
    elif kind < 6:
        # The same change in every line, as a script would make it, or two values exchanged.
        values = [json.loads(line) for line in lines]
        key = rng.choice(("angle_deg", "i", "on", "off", "lasers", "placement", "sha256"))
        change = rng.choice((lambda old: None, lambda old: 0, lambda old: old, _radians, lambda old: [old]))
        for one in values if kind == 4 else ():
            if key in one:
                one[rng.choice((key, key, key + "s"))] = change(one.pop(key))
        first, second = rng.choice(values), rng.choice(values)
        if kind == 5 and key in first and key in second:
            first[key], second[key] = second[key], first[key]
        lines = [dump(one) for one in values]
    elif lines:
        lines[at] = dump(change_tree(rng, json.loads(lines[at])))
    return b"".join(line + b"\n" for line in lines)


def _radians(old: Any) -> Any:
    return old * 0.017453292519943295 if isinstance(old, int | float) else old


_STRANGE_LINES = (
    b"",
    b"{",
    b"null",
    b"[]",
    b'{"event": "\\u001b[31m"}',
    b'{"event": "end", "journal_sha256": "0"}',
    b'{"event": "end", "journal_sha256": 7}',
    b'{"I": 3, "angle_deg": 1.0, "on": "on/000001.png"}',
    b'{"i": 3000000000, "angle_deg": 1.0, "on": "on/000001.png", "off": "off/000001.png"}',
    b'{"i": 1e400}',
    b"[" * 980 + b"]" * 980,
    b'{"i": 5, "x": ' + b"[" * 980 + b"]" * 980 + b"}",
    b'{"event": "' + b"x" * 70_000 + b'"}',
    b"\xff\xfe",
    b'{"i": 1, "i": 2}',
)

_ASSIGNMENT = re.compile(r"(?m)^([ \t]*)([A-Za-z_][\w.-]*)[ \t]*=[ \t]*(.*)$")


def change_toml(rng: random.Random, data: bytes) -> bytes:
    """A TOML file with a value, key or line changed, or with keys that cost a careless parser time and memory."""
    kind = rng.randrange(10)
    if kind < 2:
        return rng.choice((change_bytes, change_lines))(rng, data)
    text = data.decode()
    if kind == 2:
        deep = rng.choice((30, 300, 3000, 30_000))
        keys = ".".join("a" * deep)
        many = (f"{keys} = 1", f"[{keys}]", "x = " + "[" * deep + "]" * deep, "x = " + "{a=" * deep + "1" + "}" * deep)
        many += ("".join(f"k{n} = {n}\n" for n in range(deep)), "".join(f"[t{n}]\n" for n in range(deep)))
        return f"{text}{rng.choice(many)}\n".encode()
    found = list(_ASSIGNMENT.finditer(text))
    if not found:
        return change_bytes(rng, data)
    match = rng.choice(found)
    key, value = match[2], match[3]
    if kind < 7:
        value = _toml_value(rng, value)
    elif kind == 7:
        key = rng.choice((key + "x", key[:-1] or "x", key.upper(), _quoted(nasty_text(rng))))
    elif kind == 8:
        value += "\n" + rng.choice((key, _quoted(nasty_text(rng)))) + " = " + _toml_value(rng, value)
    else:
        return (text[: match.start()] + text[match.end() :]).encode("utf-8", "surrogatepass")
    changed = f"{text[: match.start()]}{match[1]}{key} = {value}{text[match.end() :]}"
    return changed.encode("utf-8", "surrogatepass")


def _toml_value(rng: random.Random, old: str) -> str:
    if rng.random() < 0.4:
        try:
            return str(near(rng, json.loads(old.split("#")[0])))
        except (ValueError, TypeError):
            pass
    return rng.choice(
        (
            *(str(nasty_number(rng)), str(nasty_number(rng)), _quoted(nasty_text(rng)), "true", "[]", "{}"),
            *("[1.0, 2.0]", "[[1, 2], [3]]", "1979-05-27", "'", "", "0x7fffffffffffffffff", "9" * 5000),
        )
    )


def _quoted(text: str) -> str:
    return json.dumps(text) if "\ud800" not in text else f'"{text}"'


def change_ply_header(rng: random.Random, data: bytes) -> bytes:
    """A PLY file with a line of its header changed."""
    end = data.find(b"end_header\n")
    lines = data[:end].split(b"\n")
    at = min(rng.randrange(1, max(2, len(lines))), len(lines) - 1)
    words = lines[at].split(b" ")
    words[rng.randrange(len(words))] = rng.choice(
        (rng.choice(TEXTS).encode("utf-8", "surrogatepass"), str(nasty_number(rng)).encode())
    )
    old, new = rng.choice(((b"float", b"double"), (b"little", b"big"), (b"uchar", b"int"), (b" x", b" y")))
    count = lambda hit: hit[1] + b" " + str(_count(rng, int(hit[2]))).encode()
    head = pick(
        rng,
        lambda: change_lines(rng, data[:end]),
        lambda: b"\n".join([*lines[:at], b" ".join(words), *lines[at + 1 :]]),
        lambda: b"\n".join([*lines[:at], rng.choice(_PLY_LINES), *lines[at:]]),
        lambda: data[:end].replace(old, new, rng.choice((1, 99))),
        lambda: re.sub(rb"(element \w+) (\d+)", count, data[:end]),
    )
    return head + data[end:]


def _count(rng: random.Random, old: int) -> int:
    return rng.choice((old, old, 0, 1, old - 1, old + 1, old // 2, 10 * old, 10**9, 10**15))


_PLY_LINES = (
    b"comment grid 16384 16384",
    b"comment grid 1 1",
    b"comment grid 0 0",
    b"comment grid 99999999999 99999999999",
    b"comment jaxscan-cloud/9",
    b"comment jaxscan-cloud/1",
    b"property list uchar int vertex_indices",
    b"property float \x1b]0;title\x07",
    b"property double x",
    b"element face 3",
    b"element vertex 0010",
    b"obj_info " + b"x" * 70_000,
)


def _places(value: Any):
    """Every (table or list, key or index) in a JSON value."""
    todo = [value]
    while todo:
        one = todo.pop()
        keys = list(one) if isinstance(one, dict) else range(len(one)) if isinstance(one, list) else ()
        # Of a long list the first few stand for all.
        for key in list(keys)[:40]:
            yield one, key
            todo.append(one[key])


def _depth(value: Any) -> int:
    depth, level = 0, [value]
    while level and depth <= 200:
        depth += 1
        level = [
            part
            for one in level
            if isinstance(one, dict | list)
            for part in list(one.values() if isinstance(one, dict) else one)[:40]
        ]
    return depth
