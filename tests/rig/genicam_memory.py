"""A GenICam device in memory: real GenApi nodes with any names, for tests."""

import struct
from dataclasses import dataclass, field

from genicam import genapi

_HEAD = """<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="Memory" VendorName="tests" StandardNameSpace="None"
SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1"
MinorVersion="0" SubMinorVersion="0" ProductGuid="6B1D4A30-0F5C-4E1B-9B62-5A7C00000003"
VersionGuid="6B1D4A30-0F5C-4E1B-9B62-5A7C00000004"
xmlns="http://www.genicam.org/GenApi/Version_1_1">
<Port Name="Device"/>
"""


@dataclass(frozen=True)
class Node:
    """One node and the initial value of its register."""

    xml: str
    value: int | float
    name: str


def amount(name, value, low, high, *, unit="", access="RW", kind="Float", step=None):
    """Return a number node; ``kind`` is Float or Integer."""
    unit = f"<Unit>{unit}</Unit>" if unit else ""
    step = f"<Inc>{step}</Inc>" if step else ""
    xml = (
        f'<{kind} Name="{name}"><pValue>{name}Reg</pValue><Min>{low}</Min><Max>{high}</Max>'
        f"{step}{unit}</{kind}>" + _register(name, access, "FloatReg" if kind == "Float" else "")
    )
    return Node(xml, float(value) if kind == "Float" else int(value), name)


def choice(name, *symbols, access="RW"):
    """Return an enumeration node, initially with its first symbol."""
    entries = "".join(
        f'<EnumEntry Name="{symbol}"><Value>{index}</Value></EnumEntry>'
        for index, symbol in enumerate(symbols)
    )
    xml = f'<Enumeration Name="{name}">{entries}<pValue>{name}Reg</pValue></Enumeration>'
    return Node(xml + _register(name, access), 0, name)


def switch(name, *, on, access="RW"):
    """Return a boolean node."""
    xml = (
        f'<Boolean Name="{name}"><pValue>{name}Reg</pValue><OnValue>1</OnValue>'
        f"<OffValue>0</OffValue></Boolean>"
    )
    return Node(xml + _register(name, access), int(on), name)


def command(name):
    """Return a command node; the port records its executions."""
    xml = (
        f'<Command Name="{name}"><pValue>{name}Reg</pValue><CommandValue>1</CommandValue></Command>'
    )
    return Node(xml + _register(name, "RW"), 0, name)


def _register(name, access, kind=""):
    kind = kind or "IntReg"
    sign = "<Sign>Signed</Sign>" if kind == "IntReg" else ""
    return (
        f'<{kind} Name="{name}Reg"><Address>@{name}@</Address><Length>8</Length>'
        f"<AccessMode>{access}</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable>{sign}"
        f"<Endianess>LittleEndian</Endianess></{kind}>"
    )


class _Port(genapi.AbstractPort):
    def __init__(self, memory):
        super().__init__()
        self._memory = memory

    def is_open(self):
        return True

    def get_access_mode(self):
        return genapi.EAccessMode.RW

    def read(self, address, length):
        return bytes(self._memory.read(address, length))

    def write(self, address, value):
        self._memory.write(address, value)


@dataclass
class Memory:
    """The device: node map, registers, names of written nodes, and nodes that do not change."""

    nodes: tuple[Node, ...]
    stuck: frozenset[str] = frozenset()
    written: list[str] = field(default_factory=list)

    def __post_init__(self):
        self._addresses = {node.name: 8 * index for index, node in enumerate(self.nodes)}
        self._names = {address: name for name, address in self._addresses.items()}
        self._bytes = bytearray().join(
            struct.pack("<d" if isinstance(node.value, float) else "<q", node.value)
            for node in self.nodes
        )
        listed = "".join(f"<pFeature>{node.name}</pFeature>" for node in self.nodes)
        xml = "".join(node.xml for node in self.nodes)
        for name, address in self._addresses.items():
            xml = xml.replace(f"@{name}@", str(address))
        self.node_map = genapi.NodeMap()
        self.node_map.load_xml_from_string(
            f'{_HEAD}<Category Name="Root">{listed}</Category>{xml}</RegisterDescription>'
        )
        self._port = _Port(self)
        self.node_map.connect(self._port, "Device")

    def read(self, address, length):
        return self._bytes[address : address + length]

    def write(self, address, value):
        name = self._names[address]
        self.written.append(name)
        if name not in self.stuck:
            self._bytes[address : address + len(value)] = value
