"""Reading and writing URDF as an lxml tree, without entities, DTDs or network."""

from __future__ import annotations

import math
from collections.abc import Iterable
from xml.etree.ElementTree import Element

import numpy as np
from lxml import etree  # pyright: ignore[reportAttributeAccessIssue]
from numpy.typing import NDArray

from morphgen.errors import MorphologyError

__all__ = [
    "Element",
    "format_vector",
    "named",
    "parse_urdf",
    "parse_xml",
    "read_vector",
    "to_text",
]

_XACRO = "(//*[starts-with(name(), 'xacro:')] | //*[@*[contains(., '${')]])[1]"
_NO_DOCTYPE = "has a DOCTYPE with entities, which a robot does not need; remove it"


def parse_xml(text: str, source: str) -> Element:
    """Parse XML text without expanding entities or reading anything else; comments are kept.

    Args:
        text: the XML.
        source: name of the file, for messages.

    Raises:
        MorphologyError: not well-formed, or has a DOCTYPE.
    """
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, encoding="utf-8")
    try:
        root = etree.fromstring(text.encode(), parser)
    except etree.XMLSyntaxError as error:
        if "<!ENTITY" in text:  # too deep or too long to be read at all
            raise MorphologyError(f"{source}: {_NO_DOCTYPE}") from error
        raise MorphologyError(f"{source}: not well-formed XML: {error}") from error
    if root.getroottree().docinfo.doctype:
        raise MorphologyError(f"{source}: {_NO_DOCTYPE}")
    return root


def parse_urdf(text: str, source: str = "URDF") -> Element:
    """Parse URDF text into its `<robot>` element, as `parse_xml`.

    Raises:
        MorphologyError: as `parse_xml`, or the root is not `<robot>`, or there are xacro macros.
    """
    root = parse_xml(text, source)
    if root.tag != "robot":
        raise MorphologyError(f"{source}: the root element is <{root.tag}>, expected <robot>")
    macro = root.xpath(_XACRO)  # pyright: ignore[reportAttributeAccessIssue]
    if macro:
        raise MorphologyError(
            f"{source}: line {macro[0].sourceline} has xacro macros; expand them first: "
            "xacro robot.urdf.xacro > robot.urdf"
        )
    return root


def to_text(root: Element) -> str:
    """Serialise a tree to text with an XML declaration."""
    return '<?xml version="1.0" encoding="utf-8"?>\n' + etree.tostring(root, encoding="unicode") + "\n"


def named(root: Element, tag: str) -> dict[str, Element]:
    """The direct children of a robot with this tag (link or joint), by name."""
    found: dict[str, Element] = {}
    for element in root.findall(tag):
        name = element.get("name")
        if not name:
            raise MorphologyError(f"a <{tag}> has no name")
        if name in found:
            raise MorphologyError(f"<{tag}> '{name}' appears twice")
        found[name] = element
    return found


def read_vector(element: Element | None, attribute: str, default: Iterable[float], where: str) -> NDArray[np.float64]:
    """Read whitespace-separated finite numbers; the default's length is the expected one.

    Args:
        element: None or an element without the attribute gives the default.
        attribute: name of the attribute.
        default: values where absent.
        where: what is read, for messages.
    """
    fallback = np.array(list(default), dtype=np.float64)
    raw = None if element is None else element.get(attribute)
    if raw is None:
        return fallback
    try:
        values = np.array([float(part) for part in raw.split()])
    except ValueError as error:
        raise MorphologyError(f"{where}: {attribute}='{raw}' is not a list of numbers") from error
    if values.shape != fallback.shape or not all(math.isfinite(v) for v in values):
        raise MorphologyError(f"{where}: {attribute}='{raw}' needs {fallback.size} finite numbers")
    return values


def format_vector(values: Iterable[float]) -> str:
    """Format numbers so that reading them back gives the same float64."""
    return " ".join(repr(float(v) + 0.0) for v in values)
