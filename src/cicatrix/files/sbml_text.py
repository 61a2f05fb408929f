"""The text of an SBML file, checked as XML before libsbml sees it: encoding, depth of nesting, and numbers."""

from __future__ import annotations

import re
from pathlib import Path
from xml.parsers import expat

from ..core.errors import InputError
from .opening import bytes_of

DEEPEST = 200  # levels of nested elements; formulas of published models have fewer than 30
BYTE_MARKS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16", b"\xef\xbb\xbf": "utf-8-sig"}
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?INF|NaN")
WHOLE = re.compile(r"[+-]?\d+")
NUMERIC = ["value", "size", "volume", "initialAmount", "initialConcentration", "stoichiometry", "spatialDimensions"]
NUMERIC += ["multiplier", "exponent", "scale"]  # attributes of SBML that are numbers
OWNERS = ["compartment", "species", "parameter", "localParameter", "speciesReference", "unit"]


def sbml_text(path: Path) -> str:
    """Return the text of an SBML file, without its XML declaration.

    Raises
    ------
    InputError
        If it is empty, no XML, no SBML, nested too deep, declares entities, or holds a number that is none; the message says
        where.
    """
    raw = bytes_of(path)
    if not raw.strip(b"\0 \t\r\n\xff\xfe\xef\xbb\xbf"):
        raise InputError(f"{path} is empty")
    scan = _Scan(path)
    scan.parse(raw)
    text = re.sub(r"^\s*<\?xml[^>]*\?>", "", raw.decode(scan.encoding(raw), errors="replace").lstrip("\ufeff"))
    return text.replace("\r\n", "\n")


class _Scan:
    """One pass over a file by expat, which keeps no tree: a formula nested 50 000 deep costs nothing."""

    def __init__(self, path: Path) -> None:
        self.path, self.depth, self.declared, self.root = path, 0, "utf-8", ""
        self.words: list[str] = []
        self.type = ""
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.XmlDeclHandler = self._declared
        self.parser.StartDoctypeDeclHandler = self._doctype
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self.words.append

    def parse(self, raw: bytes) -> None:
        """Read the whole file."""
        try:
            self.parser.Parse(raw, True)
        except expat.ExpatError as error:
            if not self.root and "<" not in raw[:200].decode("ascii", "ignore"):
                self._refuse("is not an SBML file: there is no <sbml> in it", where=False)
            words = expat.ErrorString(error.code)
            self._refuse(f"not valid SBML: the XML is broken here ({words})", error.lineno)
        except LookupError:
            self._refuse("the XML names an encoding that is not known; save it as UTF-8")
        if self.root != "sbml":
            self._refuse("is not an SBML file: there is no <sbml> in it", where=False)

    def encoding(self, raw: bytes) -> str:
        """Return the encoding that the byte order mark or the XML declaration names."""
        return next((name for mark, name in BYTE_MARKS.items() if raw.startswith(mark)), self.declared)

    def _refuse(self, words: str, line: int | None = None, where: bool = True) -> None:
        at = f": line {line or self.parser.CurrentLineNumber}: " if where else " "
        raise InputError(f"{self.path}{at}{words}")

    def _declared(self, version: str, encoding: str | None, standalone: int) -> None:
        self.declared = encoding or self.declared

    def _doctype(self, name: str, *_: object) -> None:
        self._refuse("SBML has no DOCTYPE and no entities; remove them")

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self.depth += 1
        word = name.rpartition(":")[2]
        self.root = self.root or word
        if self.depth > DEEPEST:
            self._refuse(f"elements are nested more than {DEEPEST} deep; split the formula into assignment rules")
        for key in NUMERIC if word in OWNERS else ():
            if not NUMBER.fullmatch(attributes.get(key, "0").strip()):
                self._refuse(f'{key} of <{word}> must be a decimal number; got "{attributes[key]}"')
        if word == "sep":
            self.words.append("<sep/>")
            return
        self.words.clear()
        self.type = attributes.get("type", "real")

    def _end(self, name: str) -> None:
        self.depth -= 1
        if name.rpartition(":")[2] == "cn":
            self._refuse_odd("".join(self.words).strip())

    def _refuse_odd(self, text: str) -> None:
        """Refuse the content of a <cn> that libsbml would read in part: "0x1" as 0, "1,5" as 1."""
        parts = [part.strip() for part in text.split("<sep/>")]
        kinds = {"integer": [WHOLE], "rational": [WHOLE, WHOLE], "e-notation": [NUMBER, WHOLE]}.get(self.type, [NUMBER])
        if len(parts) != len(kinds) or not all(kind.fullmatch(part) for kind, part in zip(kinds, parts)):
            self._refuse(f'<cn type="{self.type}"> must hold a decimal number; got "{text[:40]}"')
