#!/usr/bin/env python3
"""Writes golden_cdr.json: two values of each message with their CDR bytes.

The bytes are those of PyPI `rosbags`; PyPI `cyclonedds` must produce the same ones. No code of this
project is used. Run it after a change of a definition:  python msgs/tests/make_golden_cdr.py
"""

import dataclasses
import json
import random
import struct
import zlib
from pathlib import Path

import numpy
from cyclonedds import idl
from cyclonedds.idl import types
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

HERE = Path(__file__).parent
PACKAGE = HERE.parent
NUMBERS = {
    "int8": (-(2**7), 2**7 - 1), "uint8": (0, 2**8 - 1), "char": (0, 2**8 - 1),
    "byte": (0, 127), "octet": (0, 127),  # rosbags treats byte as signed
    "int16": (-(2**15), 2**15 - 1), "uint16": (0, 2**16 - 1),
    "int32": (-(2**31), 2**31 - 1), "uint32": (0, 2**32 - 1),
    "int64": (-(2**63), 2**63 - 1), "uint64": (0, 2**64 - 1),
}
CYCLONE = {
    "bool": bool, "byte": types.byte, "octet": types.byte, "char": types.uint8, "string": str,
    "float32": types.float32, "float64": types.float64,
    "int8": types.int8, "uint8": types.uint8, "int16": types.int16, "uint16": types.uint16,
    "int32": types.int32, "uint32": types.uint32, "int64": types.int64, "uint64": types.uint64,
}
BASE, NAME, ARRAY, SEQUENCE = 1, 2, 3, 4  # rosbags' kinds of field


def own_definitions():
    """Yield name and text of all interfaces; a service becomes two messages."""
    for path in sorted(PACKAGE.glob("msg/*.msg")):
        yield f"volant_msgs/msg/{path.stem}", path.read_text()
    for path in sorted(PACKAGE.glob("interfaces/*/*/*.*")):
        package = path.parent.parent.name
        if path.suffix == ".msg":
            yield f"{package}/msg/{path.stem}", path.read_text()
        else:
            request, response = ("\n" + path.read_text()).split("\n---", 1)
            for suffix, text in (("Request", request), ("Response", response.lstrip("-"))):
                # rosbags names everything .../msg/...; ROS 2 adds a dummy member to an empty half.
                text = text.strip() or "uint8 structure_needs_at_least_one_member"
                yield f"{package}/msg/{path.stem}_{suffix}", text + "\n"


def scalar(dice, name):
    if name == "bool":
        return dice.random() < 0.5
    if name == "string":
        return dice.choice(["", "a", "world", "climber/camera", "Mülheim · 22 °C", "seven c"])
    if name == "float64":
        return dice.choice([0.0, -1.5, dice.uniform(-1e3, 1e3), 1e-300])
    if name == "float32":
        return struct.unpack("<f", struct.pack("<f", dice.uniform(-1e3, 1e3)))[0]
    low, high = NUMBERS[name]
    return dice.choice([low, high, dice.randint(low, high)])


def value_of(dice, store, field):
    kind, data = int(field[0]), field[1]
    if kind == BASE:
        return scalar(dice, data[0])
    if kind == NAME:
        return message_of(dice, store, data)
    item, length = data
    count = length if kind == ARRAY else dice.randint(0, min(length, 5) if length else 5)
    return [value_of(dice, store, item) for _ in range(count)]


def message_of(dice, store, name):
    return {field: value_of(dice, store, kind) for field, kind in store.fielddefs[name][1]}


def rosbags_value(store, field, value):
    kind, data = int(field[0]), field[1]
    if kind == BASE:
        return value
    if kind == NAME:
        return rosbags_message(store, data, value)
    item = data[0]
    if int(item[0]) == BASE and item[1][0] != "string":
        name = "u1" if item[1][0] in ("byte", "octet", "char") else item[1][0]
        return numpy.array(value, dtype=name)
    return [rosbags_value(store, item, v) for v in value]


def rosbags_message(store, name, value):
    fields = {f: rosbags_value(store, kind, value[f]) for f, kind in store.fielddefs[name][1]}
    return store.types[name](**fields)


class Cyclone:
    """The same types in cyclonedds; node_kit/tests/peer_messages.py uses them, too."""

    def __init__(self, store):
        self.store = store
        self.made = {}

    def type_of(self, field):
        kind, data = int(field[0]), field[1]
        if kind == BASE:
            if data[0] == "string" and data[1]:
                return types.bounded_str[data[1]]
            return CYCLONE[data[0]]
        if kind == NAME:
            return self.struct(data)
        item, length = data
        inner = self.type_of(item)
        if kind == ARRAY:
            return types.array[inner, length]
        return types.sequence[inner, length] if length else types.sequence[inner]

    def struct(self, name):
        if name not in self.made:
            fields = {f: self.type_of(kind) for f, kind in self.store.fielddefs[name][1]}
            package, kind, base = name.split("/")
            dds = f"{package}::{kind}::dds_::{base}_"
            self.made[name] = idl.make_idl_struct(base, dds, fields)
        return self.made[name]

    def value(self, field, value):
        kind, data = int(field[0]), field[1]
        if kind == NAME:
            return self.message(data, value)
        if kind in (ARRAY, SEQUENCE):
            return [self.value(data[0], v) for v in value]
        return value

    def message(self, name, value):
        fields = {f: self.value(kind, value[f]) for f, kind in self.store.fielddefs[name][1]}
        return self.struct(name)(**fields)


def main():
    store = get_typestore(Stores.EMPTY)
    names = []
    added = {}
    for name, text in own_definitions():
        names.append(name)
        code = [line.split("#")[0].strip() for line in text.splitlines()]
        if not any(c and "=" not in c.replace("<=", "") for c in code):
            text += "uint8 structure_needs_at_least_one_member\n"
        added.update(get_types_from_msg(text, name))
    store.register(added)
    cyclone = Cyclone(store)

    golden = []
    for name in sorted(names):
        for variant in range(2):
            dice = random.Random(zlib.crc32(f"{name} {variant}".encode()))
            value = message_of(dice, store, name)
            message = rosbags_message(store, name, value)
            data = bytes(store.serialize_cdr(message, name))
            big = bytes(store.serialize_cdr(message, name, little_endian=False))
            other = cyclone.message(name, value).serialize(use_version_2=False)
            if other[4:].rstrip(b"\0") != data[4:].rstrip(b"\0"):
                difference = f"{data.hex()}\n{other.hex()}"
                raise SystemExit(f"{name}: rosbags and cyclonedds differ\n{difference}")
            service = name.endswith(("_Request", "_Response"))
            ros_name = name.replace("/msg/", "/srv/") if service else name
            encoded = {"cdr": data.hex(), "big_endian": big.hex()}
            golden.append({"type": ros_name, "value": value, **encoded})
    lines = ",\n".join(json.dumps(g, ensure_ascii=False) for g in golden)
    (HERE / "golden_cdr.json").write_text(f"[\n{lines}\n]\n")
    print(f"{len(golden)} values of {len(names)} types")


if __name__ == "__main__":
    main()
