"""A packet layout as an XTCE definition (OMG XTCE 1.2), for other ground software.

XTCE has repeated entries for lists, but few readers understand them.  Two forms do without:

- ``expanded``: a container for each combination of list lengths, chosen by the counts, in which
  every entry is parameters of its own (``stars_0_03_row_px``).  The containers multiply with every
  list, so that this is for one or two lists.
- ``binary``: each list is one binary parameter, whose size its count gives, and one entry of it is
  described by a container of its own (``stars_0_entry``), to be applied entry by entry.

Calibrated values are in the layout's units; a telemetry column may have another.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal
from xml.etree import ElementTree as ET

from stcal.errors import InputError
from stcal.telemetry.packet_fields import PacketField, PacketList
from stcal.telemetry.packet_layout import PacketLayout

NAMESPACE = "http://www.omg.org/spec/XTCE/20180204"
_SCHEMA = "https://www.omg.org/spec/XTCE/20180204/SpaceSystem.xsd"
EXPANDED_LIMIT = 5000
_ROOT, _FRAME = "CCSDSPacket", "Frame"
_HEADER = (
    ("VERSION", 3),
    ("TYPE", 1),
    ("SEC_HDR_FLG", 1),
    ("PKT_APID", 11),
    ("SEQ_FLGS", 2),
    ("SRC_SEQ_CTR", 14),
    ("PKT_LEN", 16),
)
Lists = Literal["auto", "expanded", "binary"]


def combinations(layout: PacketLayout) -> int:
    """Return how many combinations of list lengths a packet may have."""
    total = 1
    for one in layout.lists:
        total *= 1 if one.always_full else one.maximum + 1
    return total


def xtce(layout: PacketLayout, lists: Lists = "auto") -> str:
    """Return the XTCE definition of a layout as XML text.

    Raises
    ------
    InputError
        The form asked for cannot say it: too many combinations of list lengths, or entries that
        are not whole bytes.
    """
    if lists == "auto":
        lists = "expanded" if combinations(layout) <= EXPANDED_LIMIT else "binary"
    writer = _Expanded(layout) if lists == "expanded" else _Binary(layout)
    tree = writer.tree()
    ET.indent(tree, " ")
    body = ET.tostring(tree, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{body}\n'


class _Writer:
    """What both forms have: types, parameters, the containers of the header and of the frame."""

    def __init__(self, layout: PacketLayout) -> None:
        self.layout = layout
        self.root = ET.Element("SpaceSystem", {"name": _identifier(layout.name)})
        self.root.set("xmlns", NAMESPACE)
        self.root.set("xmlns:xsi", "http://www.w3.org/2001/XMLSchema-instance")
        self.root.set("xsi:schemaLocation", f"{NAMESPACE} {_SCHEMA}")
        self.root.set("shortDescription", layout.description or layout.name)
        metadata = ET.SubElement(self.root, "TelemetryMetaData")
        self.types = ET.SubElement(metadata, "ParameterTypeSet")
        self.parameters = ET.SubElement(metadata, "ParameterSet")
        self.containers = ET.SubElement(metadata, "ContainerSet")

    def head(self) -> None:
        """Write what comes before the first list."""
        self._header()
        self._frame()

    def _header(self) -> None:
        entries = self.container(_ROOT, abstract=True)
        for name, width in _HEADER:
            self.unsigned(name, width)
            _refer(entries, name)

    def _frame(self) -> None:
        """Write the container of the frame: time code and the fields before the first list."""
        entries = self.container(_FRAME, abstract=bool(self.layout.lists))
        for name, size in self.layout.time.widths:
            self.unsigned(f"time_{name}", 8 * size)
            _refer(entries, f"time_{name}")
        for field in self.layout.scalars:
            self.type_of(field.name, field)
            self.parameter(field.name, field.name, field.description)
        self.segment(entries, 0)
        self._restrict(self._extends(_FRAME, _ROOT))
        if self.layout.has_crc:
            self.unsigned("CRC", 16)

    def _restrict(self, base: ET.Element) -> None:
        """Choose the frame by the sensors' APIDs."""
        criteria = ET.SubElement(base, "RestrictionCriteria")
        apids = sorted(self.layout.apids.values())
        if len(apids) == 1:
            _compare(criteria, "PKT_APID", apids[0])
            return
        either = ET.SubElement(ET.SubElement(criteria, "BooleanExpression"), "ORedConditions")
        for apid in apids:
            condition = ET.SubElement(either, "Condition")
            left = {"parameterRef": "PKT_APID", "useCalibratedValue": "false"}
            ET.SubElement(condition, "ParameterInstanceRef", left)
            ET.SubElement(condition, "ComparisonOperator").text = "=="
            ET.SubElement(condition, "Value").text = str(apid)

    def segment(self, entries: ET.Element, number: int) -> None:
        """Refer to the fields of one segment."""
        for name, (segment, _) in self.layout.places.items():
            if segment == number:
                _refer(entries, name)

    def container(self, name: str, abstract: bool = False) -> ET.Element:
        """Add a container and return its entry list."""
        attributes = {"name": name} | ({"abstract": "true"} if abstract else {})
        return ET.SubElement(
            ET.SubElement(self.containers, "SequenceContainer", attributes), "EntryList"
        )

    def _extends(self, name: str, base: str) -> ET.Element:
        found = next(one for one in self.containers if one.get("name") == name)
        return ET.SubElement(found, "BaseContainer", {"containerRef": base})

    def unsigned(self, name: str, width: int) -> None:
        """Add a parameter that is a plain unsigned number."""
        kind = ET.SubElement(
            self.types, "IntegerParameterType", {"name": f"{name}_t", "signed": "false"}
        )
        ET.SubElement(
            kind, "IntegerDataEncoding", {"sizeInBits": str(width), "encoding": "unsigned"}
        )
        self.parameter(name, name)

    def parameter(self, name: str, kind: str, description: str = "") -> None:
        """Add a parameter of a type."""
        attributes = {"name": name, "parameterTypeRef": f"{kind}_t"}
        if description:
            attributes["shortDescription"] = description
        ET.SubElement(self.parameters, "Parameter", attributes)

    def type_of(self, name: str, field: PacketField) -> None:
        """Add the type of a field."""
        is_whole = field.kind != "f" and field.is_plain
        attributes = {"name": f"{name}_t"}
        if is_whole:
            attributes["signed"] = "true" if field.kind == "i" else "false"
        kind = "IntegerParameterType" if is_whole else "FloatParameterType"
        element = ET.SubElement(self.types, kind, attributes)
        if field.unit != "1":
            ET.SubElement(ET.SubElement(element, "UnitSet"), "Unit").text = field.unit
        _encode(element, field, self.layout.is_little(field))

    def entry_types(self, one: PacketList) -> None:
        """Add the types of a list's fields."""
        for field in one.fields:
            self.type_of(f"{one.name}_{field.name}", field)

    def end(self, entries: ET.Element, bits: int) -> None:
        """Fill up to a whole byte and add the CRC; ``bits`` are those before."""
        if fill := -bits % 8:
            name = f"fill_{fill}"
            if all(one.get("name") != name for one in self.parameters):
                self.unsigned(name, fill)
            _refer(entries, name)
        if self.layout.has_crc:
            _refer(entries, "CRC")


class _Expanded(_Writer):
    def tree(self) -> ET.Element:
        """Return the whole definition."""
        total = combinations(self.layout)
        if total > EXPANDED_LIMIT:
            raise InputError(
                f"{self.layout.name}: {total} combinations of list lengths are too many to expand "
                f"(at most {EXPANDED_LIMIT}); use the binary form"
            )
        self.head()
        for one in self.layout.lists:
            self._entries(one)
        self._expand(_FRAME, 0, self.layout.segment_bits[0])
        return self.root

    def _entries(self, one: PacketList) -> None:
        """Write the containers of a list's first n entries, each the one before and an entry."""
        self.entry_types(one)
        for n in range(1, one.maximum + 1):
            entries = self.container(f"{one.name}_{n}")
            if n > 1:
                ET.SubElement(entries, "ContainerRefEntry", {"containerRef": f"{one.name}_{n - 1}"})
            for field in one.fields:
                name = f"{one.name}_{n - 1:02d}_{field.name}"
                self.parameter(name, f"{one.name}_{field.name}", field.description)
                _refer(entries, name)

    def _expand(self, base: str, k: int, bits: int) -> None:
        """Write the containers that extend ``base`` by list k and what follows, for each length."""
        lists = self.layout.lists
        if k == len(lists):
            return
        one, is_last = lists[k], k == len(lists) - 1
        for n in [one.maximum] if one.always_full else range(one.maximum + 1):
            name = f"{base}_{n}"
            entries = self.container(name, abstract=not is_last)
            if n:
                ET.SubElement(entries, "ContainerRefEntry", {"containerRef": f"{one.name}_{n}"})
            self.segment(entries, k + 1)
            further = bits + n * one.stride + self.layout.segment_bits[k + 1]
            if is_last:
                self.end(entries, further)
            extends = ET.SubElement(self.containers[-1], "BaseContainer", {"containerRef": base})
            if not one.always_full:
                _compare(ET.SubElement(extends, "RestrictionCriteria"), one.count, n)
            self._expand(name, k + 1, further)


class _Binary(_Writer):
    def tree(self) -> ET.Element:
        """Return the whole definition."""
        self.head()
        entries = next(one for one in self.containers if one.get("name") == _FRAME)[0]
        for k, one in enumerate(self.layout.lists):
            if one.stride % 8:
                raise InputError(
                    f"{self.layout.name}: an entry of {one.name} has {one.stride} bits, which are "
                    "no whole bytes; only the expanded form can say that"
                )
            self._list(one)
            _refer(entries, one.name)
            self.segment(entries, k + 1)
        self.end(entries, sum(self.layout.segment_bits))
        next(one for one in self.containers if one.get("name") == _FRAME).attrib.pop("abstract")
        return self.root

    def _list(self, one: PacketList) -> None:
        kind = ET.SubElement(self.types, "BinaryParameterType", {"name": f"{one.name}_t"})
        size = ET.SubElement(ET.SubElement(kind, "BinaryDataEncoding"), "SizeInBits")
        if one.always_full:
            ET.SubElement(size, "FixedValue").text = str(one.stride * one.maximum)
        else:
            dynamic = ET.SubElement(size, "DynamicValue")
            reference = {"parameterRef": one.count, "useCalibratedValue": "false"}
            ET.SubElement(dynamic, "ParameterInstanceRef", reference)
            ET.SubElement(dynamic, "LinearAdjustment", {"slope": str(one.stride), "intercept": "0"})
        self.parameter(one.name, one.name)
        self.entry_types(one)
        entries = self.container(f"{one.name}_entry")
        for field in one.fields:
            name = f"{one.name}_{field.name}"
            self.parameter(name, name, field.description)
            _refer(entries, name)


def _encode(element: ET.Element, field: PacketField, little: bool) -> None:
    order = {"byteOrder": "leastSignificantByteFirst"} if little else {}
    if field.kind == "f":
        attributes = {"sizeInBits": str(field.width), "encoding": "IEEE754_1985"}
        encoding = ET.SubElement(element, "FloatDataEncoding", attributes | order)
    else:
        how = "twosComplement" if field.kind == "i" else "unsigned"
        attributes = {"sizeInBits": str(field.width), "encoding": how}
        encoding = ET.SubElement(element, "IntegerDataEncoding", attributes | order)
    if field.is_plain:
        return
    polynomial = ET.SubElement(ET.SubElement(encoding, "DefaultCalibrator"), "PolynomialCalibrator")
    for exponent, coefficient in enumerate((field.offset, field.scale)):
        term = {"coefficient": repr(coefficient), "exponent": str(exponent)}
        ET.SubElement(polynomial, "Term", term)


def _refer(entries: ET.Element, name: str) -> None:
    ET.SubElement(entries, "ParameterRefEntry", {"parameterRef": name})


def _compare(criteria: ET.Element, name: str, value: int) -> None:
    attributes = {"parameterRef": name, "value": str(value), "useCalibratedValue": "false"}
    ET.SubElement(criteria, "Comparison", attributes)


def _identifier(text: str) -> str:
    return "".join(_characters(text))


def _characters(text: str) -> Iterator[str]:
    for character in text:
        yield character if character.isalnum() or character in "_-" else "_"
