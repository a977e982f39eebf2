"""Which surveys a folder holds, of which site and when, and what tells one from another."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from ladar_volume.io.endings import CLOUD_ENDINGS, READ_ENDINGS
from ladar_volume.model.errors import InputError

#: A date in a name, with or without a time of day.
DATE = re.compile(
    r"(?<!\d)(\d{4})[-_.]?(\d{2})[-_.]?(\d{2})(?:[T_ -]?(\d{2})[-:.h]?(\d{2}))?(?!\d)"
)
#: Endings of surveys; a DXF among them is of outlines.
ENDINGS = frozenset((*CLOUD_ENDINGS, *READ_ENDINGS)) - {".dxf"}


@dataclass(frozen=True)
class SurveyFile:
    """path · site : its name · epoch : date in ISO 8601, empty where no name has one"""

    path: Path
    site: str
    epoch: str


def date_in(name: str) -> tuple[str, str]:
    """The last date in a name, in ISO 8601, and what is left of the name; empty for none."""
    for found in reversed(list(DATE.finditer(name))):
        year, month, day, hour, minute = found.groups()
        text = f"{year}-{month}-{day}" + (f"T{hour}:{minute}" if hour else "")
        try:
            datetime.fromisoformat(text)
        except ValueError:
            continue
        left = f"{name[: found.start()]} {name[found.end() :]}"
        return text, re.sub(r"[\s_.-]+", " ", left).strip()
    return "", name


def survey_files(folder: Path, without: Path | None = None) -> list[SurveyFile]:
    """All surveys below a folder, by site and epoch, but those below ``without``. Raises
    :class:`InputError`.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder", reason="input_missing", value=str(folder))
    out = []
    for path in sorted(folder.rglob("*")):
        inside = path.relative_to(folder)
        hidden = any(part.startswith(".") for part in inside.parts)
        hidden |= without is not None and path.resolve().is_relative_to(without.resolve())
        if path.suffix.lower() not in ENDINGS or not path.is_file() or hidden:
            continue
        date, left = date_in(path.stem)
        if not date:  # the folder of a survey may have it
            date = next((d for p in reversed(inside.parts[:-1]) if (d := date_in(p)[0])), "")
        parts = [date_in(part)[1] for part in inside.parts[:-1]]
        site = "/".join(part for part in (*parts, left) if part) or path.stem
        out.append(SurveyFile(path, site, date))
    if not out:
        raise InputError(
            f"{folder}: holds no survey ({' '.join(sorted(ENDINGS))})",
            reason="input_missing",
            value=str(folder),
        )
    return sorted(out, key=lambda s: (s.site, s.epoch, s.path.name))


def companions(path: Path) -> list[Path]:
    """A file and those that belong to it: a Shapefile is several."""
    others = [path.with_suffix(ending) for ending in (".dbf", ".shx", ".prj", ".cpg")]
    return [path, *(p for p in others if path.suffix.lower() == ".shp" and p.is_file())]


def key_of(survey: SurveyFile, options: Mapping[str, Any], others: Sequence[Path]) -> str:
    """What tells a result from all others: digest of the survey, of the other files that the
    options name, and of the options.
    """
    total = hashlib.sha256(json.dumps(options, sort_keys=True, default=str).encode())
    for path in (survey.path, *others):
        with path.open("rb") as file:
            total.update(hashlib.file_digest(file, "sha256").digest())
    return total.hexdigest()[:32]
