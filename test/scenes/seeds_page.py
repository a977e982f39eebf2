"""The tables of docs/seeds.md, and the doors that they name."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "seeds.md").read_text(encoding="utf-8")
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in PAGE.splitlines()
    if line.startswith("| ") and not line.startswith("| what ")
]
DOORS = sorted({word for row in ROWS for word in re.findall(r"`([^`]+)`", row[1])})
