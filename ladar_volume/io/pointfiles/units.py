"""Units of length by name, with their exact size."""

from __future__ import annotations

from dataclasses import dataclass

#: Sizes that differ by less than this part are one unit: files round 1200/3937 to 12 digits, and
#: the two feet differ by 2e-6.
SAME = 1e-8


@dataclass(frozen=True)
class Unit:
    """name · metres : its length in m"""

    name: str
    metres: float

    def __str__(self) -> str:
        return self.name

    def equals(self, other: Unit) -> bool:
        """Whether both are one length."""
        return abs(self.metres - other.metres) <= SAME * other.metres


METRE = Unit("metre", 1.0)
US_FOOT = Unit("US survey foot", 1200.0 / 3937.0)
FOOT = Unit("international foot", 0.3048)
#: Words of the command line and of headers such as ``X[m]``.
WORDS = {
    "m": METRE,
    "mm": Unit("millimetre", 1e-3),
    "cm": Unit("centimetre", 1e-2),
    "km": Unit("kilometre", 1e3),
    "ft": FOOT,
    "us-ft": US_FOOT,
}
#: By $INSUNITS of a DXF; 0 says nothing.
INSUNITS = {1: Unit("inch", 0.0254), 2: FOOT, 21: US_FOOT}
INSUNITS |= {4: WORDS["mm"], 5: WORDS["cm"], 6: METRE, 7: WORDS["km"]}
#: Other spellings in headers.
SPELLINGS = {
    "metre": "m",
    "metres": "m",
    "meter": "m",
    "meters": "m",
    "millimetre": "mm",
    "millimeter": "mm",
    "centimetre": "cm",
    "centimeter": "cm",
    "kilometre": "km",
    "kilometer": "km",
    "feet": "ft",
    "foot": "ft",
    "ift": "ft",
    "usft": "us-ft",
    "ftus": "us-ft",
    "us_ft": "us-ft",
    "us survey foot": "us-ft",
    "us survey feet": "us-ft",
}


def unit_of_word(word: str) -> Unit | None:
    """The unit that a word of a header means, or None."""
    word = word.strip().lower()
    return WORDS.get(SPELLINGS.get(word, word))


def unit_of_size(name: str, metres: float) -> Unit:
    """A unit by its size; the exact one where it is known."""
    found = Unit(name, metres)
    return next((u for u in WORDS.values() if found.equals(u)), found)
